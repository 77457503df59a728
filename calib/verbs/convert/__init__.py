"""Write a calibrated robot in the formats that controllers and ROS take."""
