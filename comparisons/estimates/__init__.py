"""Estimates: in memory, on disk, traces, and those of other systems."""
