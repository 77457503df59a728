"""Draw a board to print, true to scale, with its description; or say which board a picture shows."""
