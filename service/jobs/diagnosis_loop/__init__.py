"""The diagnosis loop: diagnosis, approved experiment, next diagnosis, accepted model revision."""
