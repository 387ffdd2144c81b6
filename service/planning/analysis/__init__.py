"""Plans of an initial analysis."""
