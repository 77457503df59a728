"""Figures and the HTML report. Imports text and below."""
