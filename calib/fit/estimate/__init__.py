"""The fit: the least-squares problem, its stages, priors and bounds. Imports registration and below."""
