"""Tasks of the event loop: one way to own them, one way to let them end (docs/explanation/concurrency.md)."""
