"""Scenes of Blender, and of formats that Blender reads, as scenes of Mitsuba.

Blender itself reads them, in a process of its own (:mod:`gpf.blender.program`): it evaluates the
geometry as for a rendering, and bakes what Mitsuba has no words for. What it writes becomes an
ordinary folder with a Mitsuba scene (:func:`gpf.blender.conversion.convert`).
"""
