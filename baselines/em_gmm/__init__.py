"""Photon density as a Gaussian mixture (EM-GMM)."""
