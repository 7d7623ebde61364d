"""The audit of any Kalman filter: what it did, recorded event by event, and judged."""
