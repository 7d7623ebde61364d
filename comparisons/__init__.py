"""Logs in, two independent estimates out, and a verdict on whether they agree."""

__part_of__ = "slamcheck"
