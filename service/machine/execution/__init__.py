"""Executes a plan on the machine and records the data of its drives."""
