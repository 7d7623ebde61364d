"""Which known fault an estimate has: the reference filter with that fault reproduces it."""
