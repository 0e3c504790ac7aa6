"""RenderFormer: a network of other authors renders the scene's triangles."""
