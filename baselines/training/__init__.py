"""Training of learned methods: the command, and the config of each method."""
