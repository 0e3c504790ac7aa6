"""RenderFormer: a published network that renders the scene's triangles."""
