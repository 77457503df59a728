"""Corners of boards in one image: markers, prediction, search, refinement."""
