"""Features that become landmarks (Guivant 2002, section 3)."""
