"""AnySplat: Gaussian splats that a network predicts from images."""
