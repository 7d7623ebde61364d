"""Landmarks that are pieces of scans: frames in the state, templates beside (Nieto 2005, ch. 5)."""
