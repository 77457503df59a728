"""``calib convert``: a result in the files of controllers, ROS, and tables."""
