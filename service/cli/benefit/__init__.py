"""The command that reports the benefit of an estimate."""
