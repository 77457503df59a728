"""Controllers' files and DH tables. Imports result and below."""
