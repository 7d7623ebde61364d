"""FastSLAM as a third estimator beside the filter and the smoother."""
