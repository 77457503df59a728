"""Plans of images: poses of a robot at which a camera sees a printed board."""
