"""What a session reads: instruments that measure, and controllers that say where the robot stands."""
