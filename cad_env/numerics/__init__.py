"""Compilation, random numbers and other numerics that know nothing of driving."""
