"""Motion from scans in place of, or beside, the odometry."""
