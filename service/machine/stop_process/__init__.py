"""The stop in a separate process (docs/explanation/decisions/0014-the-stop.md): its input and output.

The service writes single bytes to its standard input: `ORDER`, `TAKEN_OVER`, `END`, or the number of a signal. The
interpreter itself writes that number while no Python code of the service runs. The process writes JSON lines to its
standard output. An end of the input without `END` means that the service has crashed.
"""

ORDER = b"S"  # send the stop on the bus
TAKEN_OVER = b"A"  # the service handles the last stop: do not insist
END = b"E"  # the service ends regularly
