"""Filters of third parties, really run, each with a trace for `slamcheck audit`.

Each module's `record` simulates data from the filter's own model, runs the filter, and records it.
Its table `FAULTS` holds bugs that it can be given, to see what the audit says of them.
"""
