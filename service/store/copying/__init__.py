"""Copies all rows of one database to another."""
