"""The fit: residuals, registration, Levenberg-Marquardt, variance components, cross-validation. Imports data and below."""
