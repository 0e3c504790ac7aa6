"""Camera rays and their visible points."""
