"""Users of an identity provider, without a password here. Each change is in the audit."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import Conflict
from service.people.audit_chain import Entry
from service.people.names import unique_name
from service.people.permissions import Role
from service.store import rows
from service.store import tables as t
from service.store.database import Transactions
from service.store.people.audit import append
from service.store.people.names import check_free
from service.store.people.users import UserDocument, end_sessions


class ExternalUsers(Transactions):
    """Every method is one transaction and blocks. `entry`: of the audit, with user and address."""

    def renew(self, issuer: str, subject: str, name: str, role: Role | None, entry: Entry) -> UserDocument | None:
        """The user, with the role that the provider's groups give now; added at the first login.

        `name` is used only at the first login; if it exists, it belongs to another user. A `role` of None: no group
        gives a role; then existing sessions are ended, no user is added, and the result is None. A user who is
        disabled here stays disabled.
        """
        with self._database.write(quiet=True) as session:
            of_it = (t.UserRow.issuer == issuer, t.UserRow.subject == subject)
            row = session.scalar(select(t.UserRow).where(*of_it))
            if role is None:
                if row is not None:
                    end_sessions(session, row)
                    append(session, [{**entry, "event": "role lost", "user": row.name}])
                return None
            if row is None:
                row = self._added(session, issuer, subject, name, role, entry)
            elif row.role != role and row.disabled_at is None:
                row.role = role
                append(session, [{**entry, "event": "role changed", "user": row.name, "user_role": role.word}])
            return rows.document(UserDocument, row)

    def _added(self, session: Session, issuer: str, subject: str, name: str, role: Role, entry: Entry) -> t.UserRow:
        free = _free_name(session, name, subject)
        row = t.UserRow(name=free, role=role, password=None, issuer=issuer, subject=subject)
        session.add(row)
        added: Entry = {"user": free, "user_role": role.word, "issuer": issuer, "subject": subject}
        append(session, [{**entry, "event": "user added", **added}])
        session.flush()
        return row


def _free_name(session: Session, name: str, subject: str) -> str:
    """Raises Conflict if even the name with the subject is in use."""
    try:
        check_free(session, name)
    except Conflict:
        name = unique_name(name, subject)
        check_free(session, name)
    return name
