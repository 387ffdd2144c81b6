"""What the service talks about: robot, recording, geometry, results, errors, configuration."""
