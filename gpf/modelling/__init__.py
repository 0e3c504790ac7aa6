"""Procedural meshes and textures, for the builders of scenes.

numpy alone, no random state, coordinates rounded to six decimals: a builder that uses these writes
the same bytes every time, on every machine.
"""
