"""Compute compensated commands so that the real robot reaches the programmed poses."""
