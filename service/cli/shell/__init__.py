"""What a shell asks of the commands."""
