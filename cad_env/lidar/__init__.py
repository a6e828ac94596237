"""Points of a lidar, which vehicles may share in place of graphs."""
