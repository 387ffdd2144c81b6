"""Each route has its least role, and the page is that of the routes; keys are masked."""

from pathlib import Path

import pytest
from fastapi import FastAPI

from service.process.settings import Settings
from service.store.access import SCOPES, Role, key_sha256, masked, new_key
from service.web.api.route_roles import LOGINS, SOCKET, STOP, Permissions, RouteKey, allow, page
from service.web.app import create_app

PAGE = Path("docs/reference/permissions.md")


@pytest.fixture(scope="module")
def app() -> FastAPI:
    return create_app(Settings())


@pytest.fixture(scope="module")
def permissions(app: FastAPI) -> Permissions:
    return app.state.permissions


@pytest.mark.slow
def test_each_route_has_a_role_and_a_scope_and_few_need_nobody(app: FastAPI, permissions: Permissions) -> None:
    assert permissions.roles["GET", "/api/v1/audit"] is Role.ADMIN
    assert permissions.roles["GET", "/metrics"] is Role.VIEWER
    declared = {(method.upper(), path) for path, ways in app.openapi()["paths"].items() for method in ways}
    assert declared < set(permissions.roles)
    assert permissions.roles[STOP] is None
    assert {permissions.roles["GET", f"/api/v1/health/{word}"] for word in ("live", "ready")} == {None}
    free = {path for (method, path), role in permissions.roles.items() if role is None and method != "GET"}
    assert free == {STOP[1], *(path for _, path in LOGINS)}
    found = {route: permissions.scope(route) for route in permissions.roles}
    assert {scope for scope in found.values() if scope} == set(SCOPES)
    unscoped = {route for route, scope in found.items() if scope is None and permissions.roles[route] is not None}
    assert unscoped == {("GET", "/api/v1/me"), ("POST", "/api/v1/logout")}
    assert permissions.scope(STOP) is None


def test_a_route_without_a_role_is_refused_at_the_start() -> None:
    app = FastAPI(openapi_url="/api/v1/openapi.json", docs_url=None, redoc_url=None)

    @app.get("/known")
    @allow(Role.VIEWER)
    def known() -> None: ...

    assert Permissions(app.routes).roles["GET", "/known"] is Role.VIEWER

    @app.post("/new")
    def new() -> None: ...

    with pytest.raises(LookupError, match="POST /new has no role"):
        Permissions(app.routes)


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
def test_what_a_request_needs(permissions: Permissions, method: str, path: str, role: Role | None) -> None:
    entry = permissions.entry(method, path)
    assert (Role.VIEWER if entry is None else permissions.roles[entry]) is role


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
def test_what_a_key_lacks(
    permissions: Permissions, route: RouteKey | None, role: Role, scopes: tuple[str, ...] | None, needed: str
) -> None:
    assert permissions.lacking(role, scopes, route) == needed


def test_the_page_is_fresh(root: Path, permissions: Permissions) -> None:
    told = "run: python -m service.web.api.gate > docs/reference/permissions.md"
    assert (root / PAGE).read_text("utf-8") == page(permissions), told


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
