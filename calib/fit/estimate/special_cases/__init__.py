"""Special cases of an estimate: what a fit does besides, if its rows call for it; with all other rows nothing.

module            rows                                             what is done
stops             several targets are measured at one standstill   their errors in common are estimated
arm_size          nothing measures a length                        the arm keeps its nominal size
pose_covariances  measured poses have stated covariances           their scale, and what the robot adds, is estimated
"""
