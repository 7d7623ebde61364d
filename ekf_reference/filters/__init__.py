"""The compressed filter (Guivant 2002) and the direction-cosine filter (Misono 2007)."""
