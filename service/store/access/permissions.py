"""Permissions: one table, from each route to the minimum role. Pure.

`docs/reference/permissions.md` is generated from it: ``python -m service.web.api.people.permissions_page``. A test
fails for a route without an entry here, and for an entry without a route. An unknown path requires the role viewer: a
caller without a role does not get the answer "not found".
"""

import re
from collections.abc import Sequence
from enum import IntEnum

from starlette.routing import compile_path


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
SOCKET = "WEBSOCKET"
"""Used in place of the method for a WebSocket."""

Route = tuple[str, str]  # method and path
API = "/api/v1"
_V, _O, _E, _A = Role
STOP: Route = ("POST", f"{API}/stop")
SIGN_OF_LIFE: Route = ("POST", f"{API}/campaigns/{{campaign_id}}/sign_of_life")
"""Changes nothing and comes several times per minute: not in the audit, but a missing sign of life is."""
LOGIN: Route = ("POST", f"{API}/login")
OIDC_BEGIN: Route = ("POST", f"{API}/login/oidc")
OIDC_END: Route = ("POST", f"{API}/login/oidc/code")
LOGINS = (LOGIN, OIDC_BEGIN, OIDC_END)
"""Routes without a known caller: each has one entry in the audit, with its outcome."""

CALLS: dict[Route, Role | None] = {
    ("POST", "/robots"): _E,
    ("GET", "/robots"): _V,
    ("GET", "/robots/{robot_id}"): _V,
    ("POST", "/plans"): _E,
    ("GET", "/plans"): _V,
    ("GET", "/plans/{plan_id}"): _V,
    ("GET", "/plans/{plan_id}/picture"): _V,
    ("GET", "/plans/{plan_id}/grid"): _V,
    ("GET", "/cells"): _V,
    ("POST", "/plans/{plan_id}/approvals"): _E,
    ("GET", "/plans/{plan_id}/approvals"): _V,
    ("POST", "/campaigns"): _O,
    ("GET", "/campaigns"): _V,
    ("GET", "/campaigns/{campaign_id}"): _V,
    ("GET", "/campaigns/{campaign_id}/ahead"): _V,
    ("GET", "/plans/{plan_id}/ahead"): _V,
    ("POST", "/campaigns/{campaign_id}/start"): _O,
    ("POST", "/campaigns/{campaign_id}/sign_of_life"): _O,
    ("POST", "/campaigns/{campaign_id}/pause"): _O,
    ("POST", "/campaigns/{campaign_id}/resume"): _O,
    ("POST", "/campaigns/{campaign_id}/abort"): _O,
    ("GET", "/campaigns/{campaign_id}/sweeps"): _V,
    ("GET", "/campaigns/{campaign_id}/sweeps/{number}"): _V,
    ("GET", "/campaigns/{campaign_id}/sweeps/{number}/recording"): _V,
    ("GET", "/campaigns/{campaign_id}/sweeps/{number}/recording/file"): _V,
    ("GET", "/campaigns/{campaign_id}/estimates"): _V,
    ("GET", "/campaigns/{campaign_id}/estimates/latest"): _V,
    ("GET", "/campaigns/{campaign_id}/estimates/convergence"): _V,
    ("GET", "/campaigns/{campaign_id}/estimates/{revision}"): _V,
    ("GET", "/campaigns/{campaign_id}/report"): _V,
    ("GET", "/campaigns/{campaign_id}/report.{ending}"): _V,
    ("GET", "/campaigns/{campaign_id}/model.{ending}"): _V,
    ("GET", "/campaigns/{campaign_id}/bundle"): _V,
    (SOCKET, "/campaigns/{campaign_id}/live"): _V,
    ("POST", "/diagnoses"): _E,
    ("GET", "/diagnoses"): _V,
    ("GET", "/diagnoses/{diagnosis_id}"): _V,
    ("GET", "/diagnoses/{diagnosis_id}/figures"): _V,
    ("GET", "/diagnoses/{diagnosis_id}/report.html"): _V,
    ("GET", "/diagnoses/{diagnosis_id}/report.{ending}"): _V,
    ("POST", "/diagnoses/{diagnosis_id}/plan"): _E,
    ("POST", "/diagnoses/{diagnosis_id}/experiment"): _E,
    ("POST", "/diagnoses/{diagnosis_id}/model"): _E,
    ("GET", "/fleet"): _V,
    ("GET", "/fleet/report"): _V,
    ("GET", "/fleet/report.{ending}"): _V,
    ("POST", "/jobs"): _E,
    ("GET", "/jobs"): _V,
    ("GET", "/jobs/{job_id}"): _V,
    ("POST", "/jobs/{job_id}/cancel"): _E,
    ("GET", "/jobs/{job_id}/results"): _V,
    ("GET", "/jobs/{job_id}/results/{campaign_id}"): _V,
    ("GET", "/models"): _V,
    ("GET", "/models/{model_id}"): _V,
    ("GET", "/models/{model_id}/scenario.yaml"): _V,
    ("POST", "/bundles"): _E,
    ("GET", "/events"): _V,
    ("GET", "/drives"): _V,
    ("GET", "/machines"): _V,
    ("POST", "/drives/connect"): _O,
    ("POST", "/drives/{joint}/acknowledge"): _O,
    ("GET", "/stop"): None,  # contains the port of the stop process: every caller may stop and must find it
    ("POST", "/stop"): None,
    ("POST", "/stop/reset"): _O,
    ("GET", "/audit"): _A,
    ("GET", "/me"): _V,
    ("GET", "/login"): None,  # gives the page the available ways to log in
    ("POST", "/login"): None,
    ("POST", "/login/oidc"): None,
    ("POST", "/login/oidc/code"): None,
    ("POST", "/logout"): _V,
    ("GET", "/health/live"): None,
    ("GET", "/health/ready"): None,
    ("GET", "/openapi.json"): None,
}
_PAGES = ("/", "/diagnosis", "/fleet", "/plan", "/results", "/{name}.js", "/{name}.css", "/plotly.min.js", "/texts.js")
PERMISSIONS: dict[Route, Role | None] = {
    **{(method, f"{API}{path}"): role for (method, path), role in CALLS.items()},
    ("GET", "/metrics"): _V,
    **{("GET", page): None for page in _PAGES},  # public files without data
}
"""The lowest sufficient role by method and path; None: no authentication required."""


class Permissions:
    """Finds the entry of a request's path in the table."""

    def __init__(self) -> None:
        # the regular expressions of the router: this check and the routing cannot differ
        self._patterns: list[tuple[Route, re.Pattern[str]]] = [
            (route, compile_path(route[1])[0]) for route in PERMISSIONS
        ]

    def entry(self, method: str, path: str) -> Route | None:
        """The entry of a request; of several entries, the one with the highest role. None: there is no such route."""
        asked = "GET" if method == "HEAD" else method
        fitting = [route for route, pattern in self._patterns if route[0] == asked and pattern.match(path)]
        return max(fitting, key=lambda route: PERMISSIONS[route] or 0, default=None)


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
_CHANGES = {
    "campaigns": "measure",
    "drives": "machine",
    "stop": "machine",
    "robots": "store",
    "plans": "store",
    "bundles": "store",
    "diagnoses": "diagnose",
    "jobs": "diagnose",
}
"""The scope of a route that does not only read, by the first word of its path."""


def scope_of(route: Route | None) -> str | None:
    """The scope that a key needs for a route; None: any key is sufficient. An unknown path needs the scope "read"."""
    if route is None or route in {("GET", f"{API}/me"), ("POST", f"{API}/logout")} or PERMISSIONS[route] is None:
        return "read" if route is None else None
    method, path = route
    word = path.removeprefix(API).split("/")[1]
    if word in ("metrics", "audit"):
        return word
    return "read" if method in ("GET", SOCKET) else _CHANGES[word]


def lacking(role: Role, scopes: Sequence[str] | None, route: Route | None) -> str:
    """What this route requires and role and scopes (None: all) do not have; empty if nothing is missing."""
    needed = Role.VIEWER if route is None else PERMISSIONS[route]
    if needed is not None and role < needed:
        return needed.word
    scope = scope_of(route)
    return "" if scopes is None or scope is None or scope in scopes else f"scope {scope}"


def beyond(role: Role, scopes: Sequence[str] | None = None) -> dict[str, str]:
    """Routes that they may not use: lowest sufficient role, or "scope" and its word, by "METHOD /path" below `API`."""
    found = {(method, path): lacking(role, scopes, (method, f"{API}{path}")) for method, path in CALLS}
    return {f"{method} {path}": needed for (method, path), needed in found.items() if needed}
