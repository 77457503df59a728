"""Printed boards: described, drawn, found in pictures. Imports errors and basics; OpenCV is used nowhere else."""
