"""Safety checks before and during motion. Pure."""
