"""Shared by all packages: errors, files, settings, random numbers, neighbour search."""
