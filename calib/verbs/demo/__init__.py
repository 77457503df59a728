"""``calib demo``: the paper's robot, calibrated."""
