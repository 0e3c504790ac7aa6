"""The whole recipe as one function: from a scene to a field, with an estimate of its quality."""
