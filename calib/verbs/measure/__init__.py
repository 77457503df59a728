"""Measure pose by pose: the next pose, an answer to each stop, and when it is enough."""
