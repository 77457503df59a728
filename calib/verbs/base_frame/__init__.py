"""Measure the robot's base frame from points on its mounting plane and sweeps of joints 1 and 2."""
