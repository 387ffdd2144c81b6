"""Roles, and scopes of keys: sets of routes. A route carries its least role (`service.web.api.route_roles`). Pure."""

from enum import IntEnum


class Role(IntEnum):
    """Each role includes the rights of the roles before it."""

    VIEWER = 1
    OPERATOR = 2
    ENGINEER = 3
    ADMIN = 4

    @property
    def word(self) -> str:
        return self.name.lower()


MEANING = {
    Role.VIEWER: "reads everything but the audit",
    Role.OPERATOR: "runs plans that are stored, connects drives, acknowledges faults, releases stops",
    Role.ENGINEER: "stores robots, plans and bundles, approves plans, begins diagnoses and experiments, accepts models",
    Role.ADMIN: "reads the audit",
}
LOCAL = "local"
"""Name of the caller in a service without login, with all rights."""
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
