"""Conversion of samples to rows of the equations."""
