"""3D Gaussian splatting from images."""
