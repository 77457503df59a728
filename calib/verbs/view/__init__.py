"""``calib view``: robots and measurements in 3-D, as one HTML page."""
