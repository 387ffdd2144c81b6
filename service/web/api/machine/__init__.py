"""Drives, the stop and live samples."""
