"""Forms of tables: conventions of orientations, brands' columns and other options, and lists of points."""
