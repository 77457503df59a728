"""The fit: residuals, registration, the solver, variance components. Imports data and below."""
