"""Effects of the load of the axis, one file each."""
