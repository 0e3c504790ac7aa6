"""Lights -> photons: the only photon walk."""
