"""Uncertainty at a pose as a budget of its sources (GUM), checked by Monte Carlo, and forecasts of fresh errors."""
