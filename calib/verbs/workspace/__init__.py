"""Workspace and region: where the target can be, how often, and the part of space to measure in."""
