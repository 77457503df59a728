"""Virtual cells, whose errors are known, and studies of what a way of calibrating reaches on many of them."""
