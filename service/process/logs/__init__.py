"""The log of the service: its format (`lines`), and the campaign and sweep of a line (`about`)."""
