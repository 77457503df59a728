"""Virtual cells with a camera and a printed board: where both stand, and from where the board is seen."""
