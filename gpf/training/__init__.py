"""Training: targets, their points, and the optimiser that fits a field to them."""
