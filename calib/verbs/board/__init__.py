"""``calib board``: a board to print."""
