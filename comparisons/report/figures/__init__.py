"""Pictures. Functions draw on a given axis and compute nothing."""
