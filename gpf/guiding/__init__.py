"""Photons where they are needed: the visible region, guided emission, density control."""
