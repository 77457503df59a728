"""Measure: tables of measurements, the cell they were taken in, and where to measure."""
