"""Which landmark a measurement is of (Nieto 2005, section 2.4)."""
