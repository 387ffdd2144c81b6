"""Plans of trajectories of several axes."""
