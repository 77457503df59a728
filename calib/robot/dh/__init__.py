"""Robots from DH rows: the rows and their conventions, and the files that hold them."""
