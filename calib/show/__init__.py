"""The look of results: lines, tables, pages, figures, 3-D scenes, and the words of the verdict."""
