"""Which sweeps make which effects visible."""
