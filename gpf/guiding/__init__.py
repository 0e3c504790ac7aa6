"""Where photons are needed, and how they are sent there."""
