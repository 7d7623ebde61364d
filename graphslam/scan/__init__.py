"""The scan front end: raw scans become increments and loop closures with covariances."""
