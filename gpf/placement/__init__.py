"""Cameras around a scene's own, for fits without views and for `gpf scene import`.

``cameras`` chooses them, ``view_checks`` finds their faults, ``orbit`` puts them on spheres around
what a camera looks at, and ``loops`` makes paths of them.
"""
