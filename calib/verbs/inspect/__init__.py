"""Show a robot's chain, its DH rows, the parameters of a model and which of them can be identified."""
