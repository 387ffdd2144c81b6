"""Diagnoses and model revisions."""
