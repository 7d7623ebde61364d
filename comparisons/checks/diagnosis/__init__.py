"""Where a gap arose, and what would explain it."""
