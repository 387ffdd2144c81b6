"""Commands that read bundles and traces; no service needed."""
