"""Pages that show robots in 3-D, each one file. Imports report and below."""
