"""Between a log and the estimators: timeline, filter loop, EKF factory, smoother input."""
