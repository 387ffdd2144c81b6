"""Findings about samples against the robot file, one file a finding."""
