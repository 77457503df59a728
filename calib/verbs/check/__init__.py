"""Check with a few fresh poses whether anything has moved since a calibration, and what."""
