"""Login of a person with name and password; afterwards this browser has a session."""

import asyncio
import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, SecretStr, StringConstraints
from starlette.concurrency import run_in_threadpool

from service import Conflict
from service.store.access import Role
from service.store.people.audit import AuditDocument, Fact
from service.store.people.users import UserDocument, UserStore
from service.web.api.access import AuditTrail, Guesses, audit_trail_of, cookie_name, too_many, unauthorized
from service.web.api.dependencies import After, ApplicationOf, AuditOf, Limit, Page, SessionsOf
from service.web.api.route_roles import Permissions, allow
from service.web.application import Application

login_routes = APIRouter(tags=["people"])
me_routes = APIRouter(prefix="/me", tags=["people"])
audit_routes = APIRouter(prefix="/audit", tags=["people"])


class PasswordCheck:
    """Counts wrong passwords by address, together with its wrong keys, and by name, for all addresses."""

    def __init__(self, of_addresses: Guesses, most: int) -> None:
        """`most`: wrong passwords for a name within one minute."""
        self._of_addresses, self._of_names = of_addresses, Guesses(most)
        self._one = asyncio.Lock()
        self._reckoning = ThreadPoolExecutor(1, thread_name_prefix="password", initializer=_give_way)
        self._waiting = 0

    def close(self) -> None:
        """Stops its thread after the last check."""
        self._reckoning.shutdown()

    async def user(self, users: UserStore, name: str, password: str, trail: AuditTrail) -> UserDocument:
        """The user with this name and password; his name is added to the trail. RequestRefused: same text and same time
        for an unknown name as for a wrong password."""
        if self._waiting >= 8:  # attempts to log in
            trail.hushed = True
            raise too_many("attempts to log in", 1.0)
        self._waiting += 1
        try:
            async with self._one:
                return await self._look(users, name if name.isprintable() else "", password, trail)
        finally:
            self._waiting -= 1

    async def _look(self, users: UserStore, name: str, password: str, trail: AuditTrail) -> UserDocument:
        here = f"{name} {trail.address}"  # wrong passwords from elsewhere do not lock out users known at this address
        self._of_addresses.check(trail.address, here, f"wrong keys and passwords from {trail.address}", trail)
        self._of_names.check(name, here, "wrong passwords for this name", trail)
        user = await asyncio.get_running_loop().run_in_executor(self._reckoning, users.check, name, password)
        if await run_in_threadpool(users.knows, name):  # an unknown name may be a password in the wrong field
            trail.actor = name
        if user is None:
            now = time.monotonic()
            self._of_addresses.wrong(trail.address, now)
            self._of_names.wrong(name, now)
            raise unauthorized("name or password is wrong")
        self._of_names.opened(here)
        trail.actor, trail.role = user.name, user.role
        return user


def _give_way() -> None:
    """Sets the lowest priority, also for the threads that argon2 starts here. Only Linux has priorities of threads."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)


class Me(BaseModel):
    """`login`: whether the service has a login; `session`: the caller has a session and can log out.

    `refused`: the lowest sufficient role, or "scope" and its word, by "METHOD /path" below ``/api/v1``.
    """

    login: bool
    name: str
    role: str
    session: bool
    refused: dict[str, str]


def me_of(request: Request, application: Application) -> Me:
    """The caller of a request, from its audit trail."""
    trail = audit_trail_of(request.scope)
    role = Role.VIEWER if trail.role is None else trail.role
    permissions: Permissions = request.app.state.permissions
    return Me(
        login=application.settings.login,
        name=trail.actor,
        role=role.word,
        session=trail.session is not None,
        refused=permissions.beyond(role, trail.scopes),
    )


async def begin_session(
    user: UserDocument, request: Request, response: Response, application: Application, **facts: Fact
) -> Me:
    """Opens a session and sets its cookie. `facts`: additional data of its audit entry."""
    trail, settings = audit_trail_of(request.scope), application.settings
    session, token = await run_in_threadpool(application.sessions.open, user, trail.entry("logged in", **facts))
    trail.session, trail.hushed = session.id, True  # the session has its own entry in the audit
    response.set_cookie(
        cookie_name(request.scope),
        token,
        max_age=int(settings.session_longest),
        httponly=True,
        samesite="strict",
        secure=secure(request, application),
    )
    return me_of(request, application)


def secure(request: Request, application: Application) -> bool:
    """Whether browsers may send a cookie through TLS only."""
    return request.url.scheme == "https" or application.settings.behind_proxy


class Credentials(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: Annotated[str, StringConstraints(max_length=100)]
    password: SecretStr


@login_routes.post("/login")
@allow(None)
async def log_in(credentials: Credentials, request: Request, response: Response, application: ApplicationOf) -> Me:
    """Sets the cookie of a session. 401 for a wrong name or password, 429 after too many wrong ones.

    409 if the service has no login.
    """
    settings = application.settings
    if not settings.login:
        raise Conflict("login is disabled: the service runs with the setting `login: false`")
    trail = audit_trail_of(request.scope)
    check: PasswordCheck = request.app.state.password_check
    password = credentials.password.get_secret_value()
    user = await check.user(application.users, credentials.name, password, trail)
    return await begin_session(user, request, response, application)


class LoggedOut(BaseModel):
    """`session`: number of the closed session."""

    session: int


@login_routes.post("/logout")
@allow(Role.VIEWER)
async def log_out(request: Request, response: Response, sessions: SessionsOf) -> LoggedOut:
    """Closes the session of the caller. 409 for a caller without session: an admin revokes keys."""
    trail = audit_trail_of(request.scope)
    if trail.session is None:
        raise Conflict(f"{trail.actor} uses a key, not a session; revoke the key with `sweepid people revoke-key`")
    await run_in_threadpool(sessions.end, trail.session, trail.entry("session ended"))
    response.delete_cookie(cookie_name(request.scope), httponly=True, samesite="strict")
    return LoggedOut(session=trail.session)


@me_routes.get("")
@allow(Role.VIEWER)
async def who_asks(request: Request, application: ApplicationOf) -> Me:
    """The caller. Without login every caller is `local`, and nothing is refused."""
    return me_of(request, application)


@audit_routes.get("")
@allow(Role.ADMIN)
def list_audit(audit: AuditOf, after: After = 0, limit: Limit = 50, newest: bool = False) -> Page[AuditDocument]:
    """Entries, oldest first; with `newest` the last entries instead of those `after` a number.

    A change has two entries: `request` before it is executed, `outcome` with its status afterwards.

    503 if the table cannot be read.
    """
    audit.settle(5.0)  # s, longest wait for entries that are not yet written
    store = audit.store
    found = store.newest(limit) if newest else store.documents(after, limit)
    return Page(items=found, next=found[-1].number if len(found) == limit and not newest else None)
