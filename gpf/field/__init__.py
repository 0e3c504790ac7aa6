"""Gaussians on surfaces that answer how much light arrives: query, files, initialization."""
