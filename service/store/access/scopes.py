"""Scopes: sets of routes to which a key can be limited, in addition to the role. Pure."""

from collections.abc import Sequence

from service.store.access.permissions import API, CALLS, PERMISSIONS, SOCKET, Role, Route

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
_WHOEVER = {("GET", f"{API}/me"), ("POST", f"{API}/logout")}


def scope_of(route: Route | None) -> str | None:
    """The scope that a key needs for a route; None: any key is sufficient. An unknown path needs the scope "read"."""
    if route is None or route in _WHOEVER or PERMISSIONS[route] is None:
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
