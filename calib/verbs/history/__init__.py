"""Show which calibration of a robot was valid when, and restore its URDF."""
