"""Free motion of all axes, in the time domain."""
