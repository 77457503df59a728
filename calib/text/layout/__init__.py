"""Layout of printed text: paragraphs, numbers and tables; no sentences."""
