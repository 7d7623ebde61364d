"""Models of motion and of measurements, with their Jacobians."""
