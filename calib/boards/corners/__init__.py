"""Corners of a board in an image: markers, a map from the board to the image, search and refinement."""
