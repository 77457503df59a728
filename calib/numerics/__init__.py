"""Arrays in, arrays out: solvers, likelihood, scores and repeats of rows. Imports robot.kernel and below."""
