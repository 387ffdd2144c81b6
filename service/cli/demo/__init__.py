"""The demo: a virtual machine and the service as real processes, one complete campaign by the REST API, a report.

It is a normal client. In addition it reads the true parameters of the virtual robot, only after the last estimate.
"""
