"""Arrays in, arrays out: solvers, likelihood, scores and repeats of rows, rotations and poses. Imports robot and below."""
