"""What images of a board can and cannot tell: findings of a calibration with a camera."""
