"""The smoother a second time, with its own association."""
