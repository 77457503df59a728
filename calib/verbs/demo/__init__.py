"""Calibrate the paper's UR3 from its 35 laser-tracker points, or a Franka arm from pictures of a printed board."""
