"""Photons and points -> irradiance: stochastic progressive photon mapping, passes and their sums."""
