"""Cameras and boards as numbers: lens models, printed boards, and their files."""
