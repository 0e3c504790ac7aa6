"""LuxCore, the renderer behind LuxCoreRender, in a process of its own."""
