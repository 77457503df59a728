"""Rows and measurement setup of a table, and the registration of its frames and targets. Imports data and below."""
