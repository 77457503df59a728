"""The 3-D page: one HTML file with the robots, and the scripts that move them."""
