"""Pictures of a simulation: highway-env's view of the roads, and layers of what this project is about.

Drawing reads the state of a simulation and never changes it.
"""
