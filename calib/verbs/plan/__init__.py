"""Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be."""
