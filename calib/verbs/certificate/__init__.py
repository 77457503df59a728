"""Write a calibration certificate that a laboratory signs, for people and for programs (DCC)."""
