"""Virtual cells with a known truth."""
