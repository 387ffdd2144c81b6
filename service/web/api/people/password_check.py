"""Checks one password at a time and limits wrong ones: each check needs 64 MiB and about 0.1 s of all processors.

The checks run in a thread with the lowest priority: set-points of a moving axis are computed in other threads.
"""

import asyncio
import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

from starlette.concurrency import run_in_threadpool

from service.store.people.users import UserDocument, UserStore
from service.web.api.people.audit_trail import AuditTrail
from service.web.api.people.rate_limit import Guesses
from service.web.api.people.refusals import too_many, unauthorized

_MOST_WAITING = 8


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
        """The user with this name and password; his name is added to the trail. Refused: same text and same time for an
        unknown name as for a wrong password."""
        if self._waiting >= _MOST_WAITING:
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
        now = time.monotonic()
        for guesses, place, what in (
            (self._of_addresses, trail.address, f"wrong keys and passwords from {trail.address}"),
            (self._of_names, name, "wrong passwords for this name"),
        ):
            if wait := guesses.wait(place, here, now):
                trail.hushed = not guesses.first_refusal(place)
                raise too_many(what, wait)
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
