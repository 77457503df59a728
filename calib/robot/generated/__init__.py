"""URDFs that calib makes itself, of DH rows and of the arms of Universal Robots, with links drawn as cylinders."""
