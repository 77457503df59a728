"""Choose the model: held-out errors of fits, and the search for the model of the highest evidence."""
