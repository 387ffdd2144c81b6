"""The rigid robot: regressor, base parameters, physical consistency, least squares."""
