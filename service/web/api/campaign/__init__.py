"""Plans, campaigns, their sweeps and bundles."""
