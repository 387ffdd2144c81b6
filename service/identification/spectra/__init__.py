"""From the samples of a sweep to its lines."""
