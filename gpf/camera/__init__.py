"""Camera rays -> visible points: the only camera walk."""
