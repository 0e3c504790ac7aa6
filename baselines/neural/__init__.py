"""Hash grids and networks that several neural baselines share."""
