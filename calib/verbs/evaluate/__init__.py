"""``calib evaluate``: a robot on fresh rows, and acceptance by ISO 9283."""
