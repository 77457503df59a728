"""The fit: residuals, registration, the solver, variance components, cross-validation. Imports data and below."""
