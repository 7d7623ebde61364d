"""Alignment of laser scans (Nieto 2005, sections 5.3 and 5.4); no filter takes part."""
