"""Measurements and the work cell: tables, cell files and the registry of kinds. Imports model and below."""
