"""Long sums of passes: groups of views, records, pass times, clusters."""
