"""Landmarks that are pieces of scans: a frame in the state, a template in it (Nieto 2005, 5)."""
