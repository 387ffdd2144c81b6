"""Equations of the candidates, their search and selection."""
