"""Calibrate a batch of robots and flag outliers."""
