"""Photons from the emitters: emission, tracing, and sums over many passes."""
