"""Sweeps for a CNC without fieldbus connection: the target path of each as a table and as a part program."""
