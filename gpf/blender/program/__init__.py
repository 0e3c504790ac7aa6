"""Scripts that run inside Blender, or in a Python that has its package ``bpy``.

They import nothing from this project but each other. :mod:`gpf.blender.process` starts ``read.py``.
"""
