"""Arrays in, arrays out: solvers, likelihood, scores and repeats of rows, rotations. Imports robot and below."""
