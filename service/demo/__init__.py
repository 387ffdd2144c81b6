"""The demo: a virtual machine and the service as real processes, one whole campaign through the REST API, a report.

It is a client like any other. It alone reads the truth of the virtual robot, and only after the last estimate.
"""
