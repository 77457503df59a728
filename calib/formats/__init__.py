"""Files of controllers and of ROS: DH tables, origins of joints, Universal Robots; read into robots and written."""
