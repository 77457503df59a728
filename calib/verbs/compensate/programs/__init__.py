"""Robot programs in their makers' languages: read, corrected in the numbers of their targets alone, written."""
