"""Scripts that run in the environments of other authors' published code.

They import nothing from this project and need Python 3.10 or later.
:mod:`baselines.official` starts them.
"""
