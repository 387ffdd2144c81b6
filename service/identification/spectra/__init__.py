"""Samples of a sweep to its lines."""
