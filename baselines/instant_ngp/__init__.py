"""Instant-NGP: a neural radiance field from images."""
