"""Joint zeros as controllers take them: rounded, signed and in their units; their errors; tables and offset files."""
