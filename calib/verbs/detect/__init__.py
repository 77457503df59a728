"""Find the corners of printed boards in pictures, and write them with the joint values of each picture."""
