"""Who asks, and what his role keeps from him: a page shows such commands as dead, with the reason."""

from fastapi import APIRouter, Request
from pydantic import BaseModel

from service.api.dependencies import ApplicationOf
from service.api.people.trail import trail_of
from service.application import Application
from service.people.permissions import Role
from service.people.scopes import beyond

router = APIRouter(prefix="/me", tags=["people"])


class Me(BaseModel):
    """`login`: whether the service asks who it is; `session`: by a session, which can be logged out of.

    `refused`: the least role, or "scope" and its word, by "METHOD /path" below ``/api/v1``.
    """

    login: bool
    name: str
    role: str
    session: bool
    refused: dict[str, str]


@router.get("")
async def who_asks(request: Request, application: ApplicationOf) -> Me:
    """Without login everybody is `local`, and nothing is refused."""
    return me_of(request, application)


def me_of(request: Request, application: Application) -> Me:
    """Of a request whose trail tells who asks."""
    trail = trail_of(request.scope)
    role = Role.VIEWER if trail.role is None else trail.role
    return Me(
        login=application.settings.login,
        name=trail.actor,
        role=role.word,
        session=trail.session is not None,
        refused=beyond(role, trail.scopes),
    )
