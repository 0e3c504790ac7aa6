"""Scenes as files and as Mitsuba loads them: views, sensors, materials, bounds."""
