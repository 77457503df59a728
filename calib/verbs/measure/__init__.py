"""Measure a robot pose by pose: which is next, whether a row is good, and when it is enough."""
