"""Circle-point analysis: a base frame and joint axes from sweeps of single joints. Imports result and below."""
