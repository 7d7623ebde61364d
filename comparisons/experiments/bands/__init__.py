"""How often the bands of the consistency check hold for a filter that is sound."""
