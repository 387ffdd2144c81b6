"""Backup of the embedded store (SQLite and data folder), its restoration, and examination of a store."""
