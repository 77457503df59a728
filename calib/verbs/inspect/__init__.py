"""``calib inspect``: a chain, its DH rows, and what can be identified."""
