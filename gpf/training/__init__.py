"""Targets and Gaussians -> a fitted field."""
