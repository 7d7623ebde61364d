"""Monte Carlo studies of the variants."""
