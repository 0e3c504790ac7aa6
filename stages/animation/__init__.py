"""Films of the camera path, and their flicker."""
