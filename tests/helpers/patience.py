"""How long tests wait for what must come: so long that only what hangs fails, however busy the machine is."""

PATIENCE = 1200.0  # s
