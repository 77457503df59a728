"""Many robots at once. Imports report and below."""
