"""AnySplat: splats that a network predicts from images."""
