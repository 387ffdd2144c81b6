"""An entry of the audit is never replaced; the time of sessions and keys; no verdict `none` without noise floor"""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

# INSERT OR REPLACE removes the row that is in the way without firing a trigger of DELETE
_FOLLOWS = {
    "sqlite": (
        "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit "
        "WHEN NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM audit) "
        "BEGIN SELECT RAISE(ABORT, 'the audit is only ever added to'); END",
    ),
    "postgresql": (
        "CREATE FUNCTION audit_follows() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
        "IF NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM audit) THEN "
        "RAISE EXCEPTION 'the audit is only ever added to' USING ERRCODE = 'integrity_constraint_violation'; "
        "END IF; RETURN NEW; END $$",
        "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit FOR EACH ROW EXECUTE FUNCTION audit_follows()",
    ),
}
_AXES = sa.table(
    "axis_diagnosis", sa.column("id", sa.Integer()), sa.column("verdict", sa.String()), sa.column("document", sa.JSON())
)
_DIAGNOSES = sa.table("diagnosis", sa.column("id", sa.Integer()), sa.column("document", sa.JSON()))


def upgrade() -> None:
    connection = op.get_bind()
    for statement in _FOLLOWS[connection.dialect.name]:
        op.execute(statement)
    op.create_table(
        "steady_time",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    _correct_verdicts(connection)


def _correct_verdicts(connection: sa.Connection) -> None:
    of_none = sa.select(_AXES.c.id, _AXES.c.document).where(_AXES.c.verdict == "none")
    for number, document in connection.execute(of_none).all():
        if _is_baseless(document):
            row = sa.update(_AXES).where(_AXES.c.id == number)
            connection.execute(row.values(verdict="untestable", document=_corrected(document)))
    done = sa.select(_DIAGNOSES.c.id, _DIAGNOSES.c.document).where(_DIAGNOSES.c.document.is_not(None))
    for number, document in connection.execute(done).all():
        axes = (document or {}).get("axes", {})
        corrected = {joint: _corrected(axis) if _is_baseless(axis) else axis for joint, axis in axes.items()}
        if corrected != axes:
            row = sa.update(_DIAGNOSES).where(_DIAGNOSES.c.id == number)
            connection.execute(row.values(document={**document, "axes": corrected}))


def _is_baseless(axis: dict[str, Any]) -> bool:
    gap = axis.get("gap", {})
    floors = [gap.get("noise_floor_rms"), *(pose.get("noise_floor_rms") for pose in gap.get("by_pose", ()))]
    return axis.get("verdict") == "none" and all(floor is None for floor in floors)


def _corrected(axis: dict[str, Any]) -> dict[str, Any]:
    joint = axis.get("summary", "").partition(":")[0]
    told = f"{joint}: no sweep was repeated, so these sweeps cannot show whether something is missing."
    return {**axis, "verdict": "untestable", "summary": told}
