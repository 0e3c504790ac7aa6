"""Scripts that run inside other people's code, in other people's environments.

They import nothing of this project and do with Python 3.10; :mod:`gpf.baselines.official` starts
them.
"""
