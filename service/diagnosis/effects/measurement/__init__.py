"""Effects of the measurement, one file each."""
