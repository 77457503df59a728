"""The fit: rows and registration, the estimate, the choice of the model."""
