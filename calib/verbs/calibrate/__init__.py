"""``calib calibrate``: a robot and measurements in, a corrected robot out."""
