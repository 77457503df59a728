"""``calib detect``: corners of boards in pictures, as a table."""
