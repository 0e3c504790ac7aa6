"""The Gaussian photon field: Gaussians on surfaces, their query, their files, their start."""
