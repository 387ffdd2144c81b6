"""What to excite, where, and how well it will tell."""
