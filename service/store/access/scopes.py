"""Scopes: sets of routes to which a key can be limited, in addition to the role. Pure."""

SCOPES = {
    "read": "everything but metrics and the audit",
    "metrics": "GET /metrics",
    "measure": "makes, starts, pauses, resumes and aborts campaigns",
    "machine": "connects drives, acknowledges faults, releases stops",
    "store": "stores robots, plans and bundles",
    "diagnose": "diagnoses, their experiments and models; jobs",
    "audit": "the audit",
}
"""The scopes of a key, within its role."""
