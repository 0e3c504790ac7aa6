"""Scenes of Mitsuba in plain words, for other renderers.

:func:`baselines.translation.description.describe` writes a folder with ``scene.json`` and arrays
(``.npy``). It names no renderer: what other programs lack, they approximate or refuse themselves.
"""
