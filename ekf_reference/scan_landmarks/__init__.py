"""Scan-SLAM's templates and their matching (Nieto 2005, chapter 5)."""
