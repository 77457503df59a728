"""Calibrate a robot from measurements."""
