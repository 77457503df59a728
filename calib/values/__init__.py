"""What all values of calib share: checks of what they are made of, pickling, and how they are shown in one line."""
