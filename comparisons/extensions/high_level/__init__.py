"""High level landmarks found in a dense map (Nieto 2005, section 6.1)."""
