"""Stochastic progressive photon mapping: passes, their sums, and reference images."""
