"""Simulated logs with exact truth: worlds, the vehicle's path, sensors."""
