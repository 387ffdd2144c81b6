"""Sweeps for a CNC that no fieldbus reaches: each one's target path as a table and as a part program."""
