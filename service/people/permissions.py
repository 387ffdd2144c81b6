"""Who may do what: one table, from each route to the least role that it needs. Pure.

`docs/reference/permissions.md` is generated from it (``python -m service.people.page > FILE``). A test fails
when a route has no entry here, or an entry no route; of a path that is not here only a viewer hears that there is
nothing.
"""

import re
from enum import IntEnum

from starlette.routing import compile_path


class Role(IntEnum):
    """Each may what those before it may."""

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
"""Who it is where nobody is asked: with all rights."""
SOCKET = "WEBSOCKET"
"""Stands for the method of a WebSocket."""

Route = tuple[str, str]  # method and path
API = "/api/v1"
_V, _O, _E, _A = Role
STOP: Route = ("POST", f"{API}/stop")
SIGN_OF_LIFE: Route = ("POST", f"{API}/campaigns/{{campaign_id}}/sign_of_life")
"""Changes nothing, and comes several times a minute: it is not in the audit, but its absence is."""
LOGIN: Route = ("POST", f"{API}/login")

CALLS: dict[Route, Role | None] = {
    ("POST", "/robots"): _E,
    ("GET", "/robots"): _V,
    ("GET", "/robots/{robot_id}"): _V,
    ("POST", "/plans"): _E,
    ("GET", "/plans"): _V,
    ("GET", "/plans/{plan_id}"): _V,
    ("POST", "/plans/{plan_id}/approvals"): _E,
    ("GET", "/plans/{plan_id}/approvals"): _V,
    ("POST", "/campaigns"): _O,
    ("GET", "/campaigns"): _V,
    ("GET", "/campaigns/{campaign_id}"): _V,
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
    ("GET", "/models"): _V,
    ("GET", "/models/{model_id}"): _V,
    ("GET", "/models/{model_id}/scenario.yaml"): _V,
    ("POST", "/bundles"): _E,
    ("GET", "/events"): _V,
    ("GET", "/drives"): _V,
    ("POST", "/drives/connect"): _O,
    ("POST", "/drives/{joint}/acknowledge"): _O,
    ("GET", "/stop"): None,  # tells where the stop process listens: who may stop must find it
    ("POST", "/stop"): None,
    ("POST", "/stop/reset"): _O,
    ("GET", "/audit"): _A,
    ("GET", "/me"): _V,
    ("POST", "/login"): None,
    ("POST", "/logout"): _V,
    ("GET", "/health/live"): None,
    ("GET", "/health/ready"): None,
    ("GET", "/openapi.json"): None,
}
_PAGES = (  # public files without data
    "/",
    "/diagnosis",
    "/api.js",
    "/app.js",
    "/approval.js",
    "/axes.js",
    "/commands.js",
    "/diagnosis.js",
    "/elements.js",
    "/experiment.js",
    "/figures.js",
    "/findings.js",
    "/intent.js",
    "/login.js",
    "/machine.js",
    "/motion.js",
    "/moving.js",
    "/refresh.js",
    "/stream.js",
    "/wayout.js",
    "/style.css",
    "/plotly.min.js",
)
PERMISSIONS: dict[Route, Role | None] = {
    **{(method, f"{API}{path}"): role for (method, path), role in CALLS.items()},
    ("GET", "/metrics"): _V,
    **{("GET", page): None for page in _PAGES},
}
"""The least role by method and path; None: nobody needs to be anybody."""


class Permissions:
    """The table, asked for the paths of requests."""

    def __init__(self) -> None:
        # the router's own expressions: what is asked here and what runs afterwards cannot differ
        self._patterns: list[tuple[Route, re.Pattern[str]]] = [
            (route, compile_path(route[1])[0]) for route in PERMISSIONS
        ]

    def entry(self, method: str, path: str) -> Route | None:
        """The entry that a request belongs to; of several the one that needs most. None: there is no such route."""
        asked = "GET" if method == "HEAD" else method
        fitting = [route for route, pattern in self._patterns if route[0] == asked and pattern.match(path)]
        return max(fitting, key=lambda route: PERMISSIONS[route] or 0, default=None)
