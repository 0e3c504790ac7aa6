"""The Gaussian photon field: Gaussians on surfaces, their queries, files and initialisation."""
