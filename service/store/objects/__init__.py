"""Recordings that are, or will be, in a shared folder or an object store."""
