"""Draw a board to print, true to scale, with its description."""
