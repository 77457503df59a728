"""Model: the robot's kinematics, nominal and with errors, out of a URDF."""
