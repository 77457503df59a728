"""Many robots calibrated from a manifest, each into a folder of its own, and compared with each other."""
