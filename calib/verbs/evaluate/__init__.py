"""Compare a robot with measurements, and judge its accuracy by a tolerance."""
