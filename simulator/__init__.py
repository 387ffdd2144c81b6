"""A virtual machine tool: a plant that knows more physics than any fit, behind real fieldbus servers.

Public face for the service's twin (nothing else of this package may be imported by another room):
`run_sweeps`, `replay`, and their data types.
"""
