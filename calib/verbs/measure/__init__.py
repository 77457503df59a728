"""Measure with calib: a session that proposes the next pose and says when the measurements suffice."""
