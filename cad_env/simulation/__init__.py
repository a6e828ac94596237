"""One episode, or many side by side: what every environment stands on."""
