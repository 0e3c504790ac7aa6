"""Scripts that run in the environments of published code of other authors.

They import nothing of this project and run with Python 3.10 or later.
:mod:`gpf.baselines.official` starts them.
"""
