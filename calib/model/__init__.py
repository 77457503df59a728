"""What can be wrong with a robot and how it moves the target. Imports robot and below."""
