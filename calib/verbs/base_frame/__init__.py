"""Find the robot's base frame in the tracker's from points on its mounting plane and sweeps of joints 1 and 2."""
