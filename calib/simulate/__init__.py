"""Studies on virtual robots: what a way of calibrating reaches, by many trials."""
