"""Differences between the supported databases: one file for each, and nowhere else."""
