"""Films of the camera path, and how much they flicker."""
