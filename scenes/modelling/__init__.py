"""What scenes, benchmarks and tests are built from, besides the meshes, textures and waves of
:mod:`gpf.modelling`.

The same bytes are written every time and on every machine: numpy and fixed seeds alone, with
coordinates rounded to six decimals.
"""
