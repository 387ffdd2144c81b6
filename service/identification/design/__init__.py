"""Design of the excitation, choice of poses, and predicted confidence."""
