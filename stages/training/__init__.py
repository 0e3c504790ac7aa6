"""Training on references, as in the paper: Gaussians from photons, their number, checkpoints."""
