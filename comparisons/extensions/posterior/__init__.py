"""Draws of the smoother's exact posterior, which judge the Gaussians of both estimators."""
