"""The ground floor: events of a filter, their recorder, and the file; loads no estimator."""
