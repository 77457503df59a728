"""Results as Python and notebooks show them: in one line, or as a small table."""
