"""Kinds of network by name, one module each with its `FAMILY`; torch comes with the first one that is asked for."""
