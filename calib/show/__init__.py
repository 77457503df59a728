"""Pictures of a calibration for people; nothing here changes a result."""
