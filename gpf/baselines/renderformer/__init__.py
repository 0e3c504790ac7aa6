"""RenderFormer: scenes as triangles, for the authors' network."""
