"""``calib compare``: two calibrations of one robot, and its drift."""
