"""Basics of every room: errors' companions, units, arrays, values, files, tables, plugins, jobs. Imports errors."""
