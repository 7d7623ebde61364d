"""Scenarios of Monte Carlo studies: TOML files, and what they describe."""
