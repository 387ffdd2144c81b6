"""Effects of what measures, one file each."""
