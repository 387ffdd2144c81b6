"""The table of permissions is that of the routes, and the page that of the table; keys are masked."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from service.process.settings import Settings
from service.store.access.credentials import key_sha256, masked, new_key
from service.store.access.permissions import (
    LOGINS,
    PERMISSIONS,
    SCOPES,
    SOCKET,
    STOP,
    Permissions,
    Role,
    Route,
    lacking,
    scope_of,
)
from service.web.api.people.permissions_page import page
from service.web.app import create_app

PAGE = Path("docs/reference/permissions.md")


def routes_of(routes: Iterable[Any]) -> Iterator[Route]:
    """Of an application, those of included routers too."""
    for route in routes:
        if hasattr(route, "effective_candidates"):
            yield from routes_of(route.effective_candidates())
            continue
        route = getattr(route, "starlette_route", None) or route
        yield from ((method, route.path) for method in getattr(route, "methods", {SOCKET}) if method != "HEAD")


@pytest.mark.slow
def test_each_route_has_an_entry_and_each_entry_a_route() -> None:
    app = create_app(Settings())
    found = sorted(routes_of(app.routes))
    assert ("GET", "/api/v1/audit") in found
    assert len(found) == len(set(found))
    assert set(found) == set(PERMISSIONS)
    declared = {(method.upper(), path) for path, ways in app.openapi()["paths"].items() for method in ways}
    assert declared < set(found)


def test_stop_login_and_health_need_nobody() -> None:
    assert PERMISSIONS[STOP] is None
    assert {PERMISSIONS["GET", f"/api/v1/health/{word}"] for word in ("live", "ready")} == {None}
    free = {path for (method, path), role in PERMISSIONS.items() if role is None and method != "GET"}
    assert free == {STOP[1], *(path for _, path in LOGINS)}


@pytest.mark.parametrize(
    ("method", "path", "role"),
    [
        ("POST", "/api/v1/campaigns/7/start", Role.OPERATOR),
        ("GET", "/api/v1/campaigns/7/model.urdf", Role.VIEWER),
        ("HEAD", "/api/v1/openapi.json", None),
        ("POST", "/api/v1/stop/reset", Role.OPERATOR),
        ("POST", "/api/v1/stop/reset\n", Role.OPERATOR),  # as the router takes it
        ("POST", "/api/v1/no-such-thing", Role.VIEWER),
        ("PUT", "/api/v1/stop", Role.VIEWER),
        (SOCKET, "/api/v1/campaigns/7/live", Role.VIEWER),
    ],
)
def test_what_a_request_needs(method: str, path: str, role: Role | None) -> None:
    entry = Permissions().entry(method, path)
    assert (Role.VIEWER if entry is None else PERMISSIONS[entry]) is role


def test_each_route_that_needs_somebody_has_a_scope() -> None:
    found = {route: scope_of(route) for route in PERMISSIONS}
    assert {scope for scope in found.values() if scope} == set(SCOPES)
    assert {route for route, scope in found.items() if scope is None and PERMISSIONS[route] is not None} == {
        ("GET", "/api/v1/me"),
        ("POST", "/api/v1/logout"),
    }
    assert scope_of(STOP) is None


@pytest.mark.parametrize(
    ("route", "role", "scopes", "needed"),
    [
        (("POST", "/api/v1/campaigns/{campaign_id}/start"), Role.OPERATOR, None, ""),
        (("POST", "/api/v1/campaigns/{campaign_id}/start"), Role.OPERATOR, ("read", "measure"), ""),
        (("POST", "/api/v1/campaigns/{campaign_id}/start"), Role.ADMIN, ("read",), "scope measure"),
        (("POST", "/api/v1/campaigns/{campaign_id}/start"), Role.VIEWER, ("measure",), "operator"),
        (("POST", "/api/v1/stop/reset"), Role.ADMIN, ("measure",), "scope machine"),
        (("GET", "/metrics"), Role.VIEWER, ("metrics",), ""),
        (("GET", "/api/v1/robots"), Role.VIEWER, ("metrics",), "scope read"),
        (STOP, Role.VIEWER, ("metrics",), ""),
        (None, Role.VIEWER, ("metrics",), "scope read"),
    ],
)
def test_what_a_key_lacks(route: Route | None, role: Role, scopes: tuple[str, ...] | None, needed: str) -> None:
    assert lacking(role, scopes, route) == needed


def test_the_page_is_fresh(root: Path) -> None:
    told = "run: python -m service.web.api.people.permissions_page > docs/reference/permissions.md"
    assert (root / PAGE).read_text("utf-8") == page(), told


KEY = f"sweepid-{'0123456789abcdef' * 4}"  # a fixed one: the processes of a run must agree on the names of tests


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (KEY, "sweepid-(key)"),
        (f"Anna {KEY} smoke", "Anna sweepid-(key) smoke"),
        (KEY[:-1], "sweepid-(key)"),  # cut off by the limit of a field
        (f"{KEY}0", "sweepid-(key)"),
        (f"{KEY},{KEY}", "sweepid-(key),sweepid-(key)"),
        ("sweepid-0.2.0", "sweepid-0.2.0"),
        ("sweepid-diagnosis of 2026", "sweepid-diagnosis of 2026"),
    ],
)
def test_a_key_is_masked(text: str, expected: str) -> None:
    assert masked(text) == expected


def test_only_a_whole_key_has_a_hash() -> None:
    assert None not in (key_sha256(KEY), key_sha256(new_key()))
    assert [key_sha256(wrong) for wrong in (KEY[:-1], f"{KEY}0", f" {KEY}")] == [None] * 3
