"""Find the corners of printed boards in pictures, and write them beside the joint values of each picture."""
