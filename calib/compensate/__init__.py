"""Putting a calibration to use: commands that bring the true robot where it should be, and robots' own file formats."""
