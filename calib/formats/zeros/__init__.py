"""Joint zeros as controllers take them: rounded, signed and in their units; what they buy; tables and offset files."""
