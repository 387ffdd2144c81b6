"""Idempotency keys: a request sent twice to a service has one effect and gets the same answer twice."""

from sqlalchemy import delete

from service.model.errors import Conflict
from service.store import rows
from service.store import tables as t
from service.store.database import Transactions
from service.store.documents import StoredAnswer


class KeyReused(Conflict):
    """The key was used before with another request: an error of the client program (API: 422)."""


class IdempotencyKeys(Transactions):
    """Claim a key, do the work, store the answer; release the key if the work failed."""

    def claim(self, key: str, fingerprint: str) -> StoredAnswer | None:
        """None: continue, the key is claimed. `fingerprint`: hash of method, path and body, at most 64 characters.

        Raises Conflict while the first request with this key is in progress; KeyReused if it was another request.
        """
        with self._database.write(quiet=True) as session:
            machine = rows.own(session)
            row = session.get(t.IdempotencyRow, (machine, key))
            if row is None:
                session.add(t.IdempotencyRow(machine_id=machine, key=key, fingerprint=fingerprint))
                return None
            if row.fingerprint != fingerprint:
                raise KeyReused(f"Idempotency-Key {key!r} was used for another request")
            if row.status is None:
                raise Conflict(f"the request with Idempotency-Key {key!r} is still being processed")
            return StoredAnswer(status=row.status, body=row.body)

    def answer(self, key: str, status: int, body: str) -> None:
        """Store the answer for repeated requests with this key."""
        with self._database.write(quiet=True) as session:
            row = session.get_one(t.IdempotencyRow, (rows.own(session), key))
            row.status, row.body = status, body

    def release(self, key: str) -> None:
        """The work failed without effect: the key may be used again."""
        with self._database.write(quiet=True) as session:
            mine = t.IdempotencyRow.machine_id == rows.own(session)
            session.execute(delete(t.IdempotencyRow).where(t.IdempotencyRow.key == key, mine))

    def release_unanswered(self) -> None:
        """At start: requests that the last process did not finish may be sent again."""
        with self._database.write(quiet=True) as session:
            mine = t.IdempotencyRow.machine_id == rows.own(session)
            session.execute(delete(t.IdempotencyRow).where(t.IdempotencyRow.status.is_(None), mine))
