"""Write a calibrated robot in the formats of controllers and ROS."""
