"""What every room needs: errors' companions, units, arrays, values, files, tables, plugins, jobs. Imports errors."""
