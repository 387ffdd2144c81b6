"""Estimates, diagnoses, model revisions and model files."""
