"""Networks that read points of a lidar, own and shared."""
