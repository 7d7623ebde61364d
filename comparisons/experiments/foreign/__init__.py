"""A filter that shares no code with the reference, and faults to be planted in it."""
