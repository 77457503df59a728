"""Simulate measurements of a robot whose errors are known."""
