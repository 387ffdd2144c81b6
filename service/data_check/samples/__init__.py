"""Findings about the samples themselves, one file a finding."""
