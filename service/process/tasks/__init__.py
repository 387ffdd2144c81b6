"""Tasks of the event loop: ownership and end of all tasks (docs/explanation/concurrency.md)."""
