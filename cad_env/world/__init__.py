"""The engine: arrays of vehicles and compiled functions that move them. The only owner of the truth."""
