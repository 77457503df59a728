"""All English: what the program prints about results, from codes and numbers. Imports formats and below."""
