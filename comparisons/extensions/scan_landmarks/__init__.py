"""Scan-SLAM: landmarks made of scans (Nieto 2005, chapter 5)."""
