"""Calibrate, check and look up in a browser, on this computer alone."""
