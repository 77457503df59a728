"""Sample the reachable workspace of the target, and find the region to measure in."""
