"""Diagnosis, approved experiment, next diagnosis, accepted model revision."""
