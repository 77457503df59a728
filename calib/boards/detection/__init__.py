"""Boards in pictures, by the run: pictures and rows matched, corners or reasons for each, mistakes by name."""
