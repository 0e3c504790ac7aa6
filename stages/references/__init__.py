"""Rendering the references: groups of views, samples and passes, training targets, a cluster."""
