"""What the rows say of a fit besides its errors, and the verdict that follows."""
