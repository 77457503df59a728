"""What was found and how far to trust it, one `Calibration` in memory and on file. Imports estimate and below."""
