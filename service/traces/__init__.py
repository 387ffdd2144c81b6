"""Recordings of other tools, read into bundles."""
