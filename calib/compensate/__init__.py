"""Putting a calibration to use: commands that bring the actual robot where it should be."""
