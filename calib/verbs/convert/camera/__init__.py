"""A calibrated camera handed over: its mount in the URDF, its pose as ROS takes it, and its intrinsics as files."""
