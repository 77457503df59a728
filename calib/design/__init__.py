"""Where to measure: workspace and region, candidates, the choice among them, their order, and what they will give."""
