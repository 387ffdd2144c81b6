"""Reports of measurement and identification: one HTML file without need of network or service, or PDF."""
