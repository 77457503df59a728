"""A URDF in: the chain of joints, its kinematics, and the bytes to write back. Imports errors, units and files."""
