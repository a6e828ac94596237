"""Episodes in closed loop, and what they are worth: rates with intervals, tables. Public names are in `cad_env`."""
