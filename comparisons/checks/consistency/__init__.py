"""Whether the filter is as certain as it may be: NEES, NIS, filter against smoother."""
