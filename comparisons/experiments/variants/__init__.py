"""Consistent variants of EKF-SLAM, many runs at once."""
