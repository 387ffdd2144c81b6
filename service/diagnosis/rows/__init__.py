"""Samples to rows of the equations."""
