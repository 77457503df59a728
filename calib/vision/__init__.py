"""Pictures of printed boards: drawn, recognised, searched for corners. These modules need OpenCV."""
