"""Boards in pictures: each picture is read and searched; all of them together show mistakes in a description."""
