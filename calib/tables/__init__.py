"""Tables as text: separators, headers and cells, from text files and from sheets of Excel files."""
