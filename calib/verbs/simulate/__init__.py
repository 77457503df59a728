"""Virtual cells with a known truth, and studies of many of them. Imports design and below."""
