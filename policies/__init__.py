"""Who decides, learned: the network, what trains it, keeps it and drives with it. Only here is torch known."""
