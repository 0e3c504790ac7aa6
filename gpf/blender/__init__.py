"""Scenes of Blender, and of formats that Blender reads, as scenes of Mitsuba.

Blender itself reads them, in a process of its own, by the scripts in the folder ``program``, which
import nothing from this project but each other. It evaluates the geometry as for a rendering, and
bakes what Mitsuba has no words for. What it writes becomes an ordinary folder with a Mitsuba scene
(:func:`gpf.blender.conversion.convert`).
"""
