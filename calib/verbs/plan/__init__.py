"""Where to measure: workspace, region, collisions, optimal poses, forecasts. Imports result and below."""
