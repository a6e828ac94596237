"""Methods scored in closed loop on the same seeds."""
