"""Episodes in closed loop, and what they are worth: rates with intervals, tables."""
