"""Scenes: their files, views, sensors, materials and bounds."""
