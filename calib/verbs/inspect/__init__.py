"""Say what a folder holds and what comes next; or show a robot's chain, and what measurements tell of it."""
