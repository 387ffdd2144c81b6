"""Where in the motion model and measurement differ."""
