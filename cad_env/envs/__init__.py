"""Environments of Gymnasium and PettingZoo over the simulation."""
