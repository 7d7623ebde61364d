"""Logs: records, the folder format, readers of public data sets, simulation."""
