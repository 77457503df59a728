"""Show robots and measurements in the browser."""
