"""Landmarks made of scans: frames in the state, templates beside it (Nieto 2005, chapters 5, 6)."""
