"""A verdict `none` without noise floor, stored by an older version, is corrected once."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from service.store.database import open_database
from service.store.diagnosis.diagnoses import DiagnosisStore
from tests.stored.documents import axis_document, diagnosis_document


def without_floor(axis: dict[str, Any]) -> dict[str, Any]:
    poses = [pose | {"noise_floor_rms": None} for pose in axis["gap"]["by_pose"]]
    return axis | {"gap": axis["gap"] | {"noise_floor_rms": None, "by_pose": poses}}


def test_none_without_noise_floor_is_untestable_after_the_migration(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'sweepid.sqlite'}"
    with open_database(url):
        pass
    sound = axis_document((), verdict="none", summary="joint_1: the model is right")
    axes = {"joint_1": without_floor(sound), "joint_2": sound}
    with closing(sqlite3.connect(tmp_path / "sweepid.sqlite")) as old, old:
        old.executescript(
            "DROP TABLE steady_time; DROP TRIGGER audit_no_replace;"
            "UPDATE alembic_version SET version_num = '0013';"
            "INSERT INTO robot (id, name, sha256, description, urdf_text, created_at)"
            " VALUES (1, 'r', 'x', '{}', '', '2026-01-01');"
            "INSERT INTO diagnosis (id, robot_id, machine_id, campaigns, axes, state, cause, unattended, created_at)"
            " VALUES (1, 1, 1, '[1]', '[]', 'done', '', 0, '2026-01-01');"
        )
        old.execute("UPDATE diagnosis SET document = ?", [json.dumps(diagnosis_document(**axes))])
        rows = [(joint, "none", json.dumps(axis)) for joint, axis in axes.items()]
        old.executemany("INSERT INTO axis_diagnosis (diagnosis_id, joint, verdict, document) VALUES (1, ?, ?, ?)", rows)
    with open_database(url) as database:
        found = DiagnosisStore(database).diagnosis(1)
        assert found.verdicts == {"joint_1": "untestable", "joint_2": "none"}
        assert {joint: axis.verdict for joint, axis in found.found().axes.items()} == found.verdicts
    with closing(sqlite3.connect(tmp_path / "sweepid.sqlite")) as new:
        documents = [json.loads(row[0]) for row in new.execute("SELECT document FROM axis_diagnosis ORDER BY joint")]
    assert [one["verdict"] for one in documents] == ["untestable", "none"]
    assert "cannot show whether something is missing" in documents[0]["summary"]
