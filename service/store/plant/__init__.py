"""Queries over all machines of a plant."""
