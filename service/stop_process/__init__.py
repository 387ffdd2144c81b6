"""The stop as a process of its own (docs/explanation/decisions/0014-the-stop.md): what it is told, and what it tells.

The service writes single bytes to its standard input: `ORDER`, `TAKEN_OVER`, `END`, or the number of a signal, which
the interpreter itself writes there while no Python of the service runs. It writes JSON lines to its standard output.
The input's end without `END` is the service's death.
"""

ORDER = b"S"  # put the stop on the wire
TAKEN_OVER = b"A"  # the service has the last stop in hand: do not insist
END = b"E"  # the service ends in good order
