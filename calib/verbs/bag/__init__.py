"""Make a table of measurements from a ROS bag, without ROS."""
