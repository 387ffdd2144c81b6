"""All axes: the estimate, its combinations and its document."""
