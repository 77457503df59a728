"""Circle-point analysis: the base frame and the joints' axes from the arcs that single joints draw."""
