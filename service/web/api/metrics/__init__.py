"""Metrics for Prometheus. They are read from the application at each scrape.

`figure` defines one metric; `machine`, `work`, `plant` and `quality` are groups of metrics; `route` answers a scrape;
`page` writes the reference of all metrics.
"""
