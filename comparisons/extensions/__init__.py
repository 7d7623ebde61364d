"""Features that a run may have besides its two estimators, one folder each."""
