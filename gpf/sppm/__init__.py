"""Stochastic progressive photon mapping: passes, and the settings of references."""
