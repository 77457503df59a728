"""Compare a robot with measurements, and test its accuracy against a tolerance."""
