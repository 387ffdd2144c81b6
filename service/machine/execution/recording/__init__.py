"""Handling of the samples of a sweep: written, checked, recovered after a restart."""
