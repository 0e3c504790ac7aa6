"""A neural radiance cache: irradiance from a network."""
