"""Where in the motion the model and the measurement differ."""
