"""Who may use a route: its least role stands on it, as `@allow(Role.ENGINEER)`; a key may be limited to scopes as well.

A route without a role is an error at the start of the service. An unknown path requires the role viewer: a caller
without a role does not get the answer "not found".
``python -m service.web.api.route_roles > docs/reference/permissions.md`` writes the table of all routes.
"""

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from starlette.routing import compile_path

from service.store.access import MEANING, SCOPES, Role

SOCKET = "WEBSOCKET"
"""Used in place of the method for a WebSocket."""
RouteKey = tuple[str, str]  # method and path
API = "/api/v1"
STOP: RouteKey = ("POST", f"{API}/stop")
SIGN_OF_LIFE: RouteKey = ("POST", f"{API}/campaigns/{{campaign_id}}/sign_of_life")
"""Changes nothing and comes several times per minute: not in the audit, but a missing sign of life is."""
LOGINS: tuple[RouteKey, ...] = tuple(("POST", f"{API}/login{way}") for way in ("", "/oidc", "/oidc/code"))
"""Routes without a known caller: each has one entry in the audit, with its outcome."""

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])


def allow(role: Role | None) -> Callable[[Endpoint], Endpoint]:
    """The least role of a route; None: no authentication required."""

    def mark(endpoint: Endpoint) -> Endpoint:
        endpoint.__dict__["least_role"] = role
        return endpoint

    return mark


class Permissions:
    """The routes of an application. `roles`: the least role by method and path, in their order."""

    def __init__(self, routes: Iterable[Any]) -> None:
        """LookupError for a route without a role."""
        self.roles = dict(_roles(routes))
        # the regular expressions of the router: this check and the routing cannot differ
        self._patterns: list[tuple[RouteKey, re.Pattern[str]]] = [
            (route, compile_path(route[1])[0]) for route in self.roles
        ]

    def entry(self, method: str, path: str) -> RouteKey | None:
        """The route of a request; of several, the one with the highest role. None: there is no such route."""
        asked = "GET" if method == "HEAD" else method
        fitting = [route for route, pattern in self._patterns if route[0] == asked and pattern.match(path)]
        return max(fitting, key=lambda route: self.roles[route] or 0, default=None)

    def scope(self, route: RouteKey | None) -> str | None:
        """The scope that a key needs for a route; None: any key is sufficient. An unknown path needs "read"."""
        if route is None:
            return "read"
        method, path = route
        if self.roles[route] is None or path in (f"{API}/me", f"{API}/logout"):
            return None
        word = path.removeprefix(API).split("/")[1]
        if word in ("metrics", "audit"):
            return word
        if method in ("GET", SOCKET):
            return "read"
        changes = {"campaigns": "measure"} | dict.fromkeys(("drives", "stop"), "machine")
        changes |= dict.fromkeys(("robots", "plans", "bundles"), "store")
        return (changes | dict.fromkeys(("diagnoses", "jobs", "payloads"), "diagnose"))[word]

    def lacking(self, role: Role, scopes: Sequence[str] | None, route: RouteKey | None) -> str:
        """What this route requires and role and scopes (None: all) do not have; empty if nothing is missing."""
        needed = Role.VIEWER if route is None else self.roles[route]
        if needed is not None and role < needed:
            return needed.word
        scope = self.scope(route)
        return "" if scopes is None or scope is None or scope in scopes else f"scope {scope}"

    def beyond(self, role: Role, scopes: Sequence[str] | None = None) -> dict[str, str]:
        """What `lacking` says of each route below `API` that they may not use, by "METHOD /path"."""
        found = {route: self.lacking(role, scopes, route) for route in self.roles if route[1].startswith(API)}
        return {f"{method} {path.removeprefix(API)}": needed for (method, path), needed in found.items() if needed}


def _roles(routes: Iterable[Any]) -> Iterator[tuple[RouteKey, Role | None]]:
    """Of the routes of an application, those of included routers too."""
    for route in routes:
        if hasattr(route, "effective_candidates"):
            yield from _roles(route.effective_candidates())
            continue
        route = getattr(route, "starlette_route", None) or route
        for method in getattr(route, "methods", {SOCKET}) - {"HEAD"}:
            if route.path == f"{API}/openapi.json":  # FastAPI's own
                yield (method, route.path), None
                continue
            if not hasattr(route.endpoint, "least_role"):
                raise LookupError(f"{method} {route.path} has no role: `@allow(...)`")
            yield (method, route.path), route.endpoint.least_role


def page(permissions: Permissions) -> str:
    """The reference page, as Markdown."""
    rows = [
        f"| `{method}` | `{path}` | {_word(role)} | {permissions.scope((method, path)) or ''} |".replace("  |", " |")
        for (method, path), role in sorted(permissions.roles.items(), key=lambda one: one[0][::-1])
    ]
    lines = [
        "# Permissions",
        "",
        "Generated from the roles on the routes in `service/web/api`. It holds with the setting `login: true`;",
        "without it, every client is `local` and may do everything:",
        "[Let others in](../how-to/let-others-in.md).",
        "",
        "| role | permissions, in addition to those of the roles above |",
        "|---|---|",
        *(f"| {role.word} | {MEANING[role]} |" for role in Role),
        "",
        "STOP requires no login, here and at the port of the stop process.",
        "",
        "A key may be limited to scopes (`sweepid people add-key --scope WORD`), and then needs both role and scope.",
        "",
        "| scope | gives access to |",
        "|---|---|",
        *(f"| {scope} | {opens} |" for scope, opens in SCOPES.items()),
        "",
        "| method | path | least role | scope |",
        "|---|---|---|---|",
        *rows,
    ]
    return "\n".join(lines) + "\n"


def _word(role: Role | None) -> str:
    return "no login" if role is None else role.word


if __name__ == "__main__":
    from service.process.settings import Settings
    from service.web.app import create_app

    sys.stdout.write(page(create_app(Settings()).state.permissions))
