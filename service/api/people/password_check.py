"""One password after the other, and not many wrong ones: each costs 64 MiB and some 0.1 s of all processors.

They are reckoned by a thread that gives way to all others: the set-points of a moving axis are among those.
"""

import asyncio
import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

from starlette.concurrency import run_in_threadpool

from service.api.people.refusals import too_many, unauthorized
from service.api.people.trail import Trail
from service.people.guesses import Guesses
from service.store.people.users import UserDocument, UserStore

_MOST_WAITING = 8


class PasswordCheck:
    """Counts the wrong ones of an address, with its wrong keys, and those for a name, from wherever they come."""

    def __init__(self, of_addresses: Guesses, most: int) -> None:
        """`most`: wrong ones for a name within a minute."""
        self._of_addresses, self._of_names = of_addresses, Guesses(most)
        self._one = asyncio.Lock()
        self._reckoning = ThreadPoolExecutor(1, thread_name_prefix="password", initializer=_give_way)
        self._waiting = 0

    def close(self) -> None:
        """Ends its thread, when the last password is reckoned."""
        self._reckoning.shutdown()

    async def user(self, users: UserStore, name: str, password: str, trail: Trail) -> UserDocument:
        """Who that is, whose name the trail then has. Refused: the same words, after the same time, for a name that
        nobody has."""
        if self._waiting >= _MOST_WAITING:
            trail.hushed = True
            raise too_many("attempts to log in", 1.0)
        self._waiting += 1
        try:
            async with self._one:
                return await self._look(users, name if name.isprintable() else "", password, trail)
        finally:
            self._waiting -= 1

    async def _look(self, users: UserStore, name: str, password: str, trail: Trail) -> UserDocument:
        here = f"{name} {trail.address}"  # who logged in from here before is not locked out by who guesses elsewhere
        now = time.monotonic()
        for guesses, place, what in (
            (self._of_addresses, trail.address, f"wrong keys and passwords from {trail.address}"),
            (self._of_names, name, "wrong passwords for this name"),
        ):
            if wait := guesses.wait(place, here, now):
                trail.hushed = not guesses.first_refusal(place)
                raise too_many(what, wait)
        user = await asyncio.get_running_loop().run_in_executor(self._reckoning, users.check, name, password)
        if await run_in_threadpool(users.knows, name):  # what is no name may be a password in the wrong field
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
    """The threads that argon2 starts in this one do so as well. Elsewhere a thread has no priority of its own."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
