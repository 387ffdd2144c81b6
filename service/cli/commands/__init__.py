"""Declarations of the commands: name, options and help.

These modules are imported to print a help text, so they import nothing that computes: each command imports what it
uses when it is called (`tests/architecture/test_light_commands.py`).
"""
