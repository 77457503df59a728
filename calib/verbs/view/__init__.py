"""Show robots, and what was measured, in the browser."""
