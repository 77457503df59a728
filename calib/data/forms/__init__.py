"""Forms in which people have tables: brands' columns, conventions of orientations, sheets, numbers, points."""
