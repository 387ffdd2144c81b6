"""Moves the machine through a plan and records what its drives measure."""
