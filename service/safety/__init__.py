"""What may move, checked before anything does and while it does. Pure."""
