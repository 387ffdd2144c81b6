"""Copies of the embedded store (SQLite and data folder), the way back, and what is wrong with one."""
