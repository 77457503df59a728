"""What a report shows of images: residuals over the image and the board, images one by one, and what was covered."""
