"""Effects of friction, one file each."""
