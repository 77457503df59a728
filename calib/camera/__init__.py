"""Cameras as numbers: lens models, poses of boards, camera files."""
