"""The commands of `gpf` that need a checkout of the project."""
