"""A neural radiance cache: irradiance by a network."""
