"""Effects of what the axis carries, one file each."""
