"""Rendering the references: groups of views, their passes, previews, pass times, a cluster."""
