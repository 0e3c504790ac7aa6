"""Procedural meshes and textures for scene builders.

They use only numpy and fixed seeds, and coordinates are rounded to six decimals, so a builder
writes the same bytes every time and on every machine.
"""
