"""The chain of the audit: whoever changes, removes or cuts off something is found, with the number."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from sqlalchemy import text
from structlog.testing import capture_logs

from service import BadInput, Conflict
from service.cli.commands.people import add_key, export_audit, list_people
from service.store.access import LOCAL
from service.store.database import Database, open_database
from service.store.people.audit import (
    FIRST,
    AuditBroken,
    AuditHeads,
    AuditStore,
    AuditWriter,
    NotAudited,
    canonical,
    heads_in,
    read_head,
    sha256,
    verify,
)
from service.store.people.users import KeyStore
from tests.command import sweepid
from tests.unit.service.api.conftest import serving
from tests.unit.service.people.conftest import calling

pytestmark = pytest.mark.slow

ENTRIES = [{"event": "request", "actor": f"p{number}", "why": "ü\ud800"} for number in range(5)]


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Database]:
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        AuditStore(database).append(ENTRIES)
        yield database


def tamper(database: Database, *statements: str) -> None:
    with database.write() as session:
        for statement in ("DROP TRIGGER audit_no_update", "DROP TRIGGER audit_no_delete", *statements):
            session.execute(text(statement))


def test_a_chain_by_hand() -> None:
    first, second = canonical({"b": 1, "a": "é"}), canonical({})
    assert first == '{"a":"\\u00e9","b":1}'
    one = sha256(FIRST, first)
    two = sha256(one, second)
    assert one == "4265935f7ed3c326fd1560074c2d2f4d8a837229523e7221b6641b5f7c265887"
    assert verify([(1, first, one), (2, second, two)]) == (2, two)
    assert verify([]) == (0, FIRST)


@pytest.mark.parametrize(
    ("statement", "number", "reason"),
    [
        ("UPDATE audit SET entry = replace(entry, 'p2', 'p9') WHERE number = 3", 3, "its hash"),
        (f"UPDATE audit SET sha256 = '{FIRST}' WHERE number = 4", 4, "its hash"),
        ("DELETE FROM audit WHERE number = 2", 2, "is missing"),
        ("DELETE FROM audit WHERE number = 1", 1, "is missing"),
        ("DELETE FROM audit WHERE number = 5", 5, "is missing"),  # by the head that was kept
        ("INSERT INTO audit VALUES (6, '{}', 'abc')", 6, "its hash"),
    ],
)
def test_a_tampered_entry_is_found(own: Database, statement: str, number: int, reason: str) -> None:
    store = AuditStore(own)
    head = verify(store.links())
    tamper(own, statement)
    with pytest.raises(AuditBroken, match=rf"^audit entry {number}: {reason}") as broken:
        verify(store.links(), (head,))
    assert broken.value.number == number


@pytest.mark.parametrize("head", ["", "5", "5:abc", f"x:{FIRST}", f"1:{FIRST}0"])
def test_what_is_no_head_is_refused(head: str) -> None:
    with pytest.raises(BadInput, match="--head"):
        read_head(head)


def rechained(database: Database, number: int) -> None:
    """Replace an entry and all hashes after it, as somebody who can write to the file may do."""
    links, previous = list(AuditStore(database).links()), FIRST
    with database.write() as session:
        for trigger in ("audit_no_update", "audit_no_delete", "audit_no_replace"):
            session.execute(text(f"DROP TRIGGER {trigger}"))
        for at, entry, _ in links:
            entry = entry.replace("p", "q") if at == number else entry
            previous = sha256(previous, entry)
            row = {"number": at, "entry": entry, "sha256": previous}
            session.execute(text("INSERT OR REPLACE INTO audit VALUES (:number, :entry, :sha256)"), row)


def checked(folder: Path, *arguments: str) -> CompletedProcess[str]:
    return sweepid("audit", "verify", "--data-dir", str(folder), *arguments)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda own: rechained(own, 2), "audit entry 5: its hash is "),
        (lambda own: tamper(own, "DELETE FROM audit WHERE number > 3"), "audit entry 4: is missing"),
        (lambda own: tamper(own, "DELETE FROM audit"), "audit entry 1: is missing"),
    ],
    ids=["replaced", "cut off", "emptied"],
)
def test_a_chain_that_fits_in_itself_is_not_trusted(
    own: Database, tmp_path: Path, change: Callable[[Database], None], told: str
) -> None:
    """By the file of the service, by the same file elsewhere, by a log, by one head."""
    elsewhere = tmp_path / "elsewhere" / "service.log"
    elsewhere.parent.mkdir()
    AuditHeads(AuditStore(own), tmp_path / "audit-heads.txt").note(at_end=True)
    number, value = AuditStore(own).head()
    elsewhere.write_text(json.dumps({"event": "audit_head", "head": f"{number}:{value}"}))
    assert checked(tmp_path).stdout == f"{number}:{value}\n"
    change(own)
    verify(AuditStore(own).links())  # fits
    for given in ((), ("--head", str(elsewhere)), ("--head", f"{number}:{value}")):
        found = checked(tmp_path, *given)
        assert (found.returncode, found.stdout) == (1, "")
        assert told in found.stderr


def test_without_a_head_it_is_told_that_a_cut_is_not_noticed(own: Database, tmp_path: Path) -> None:
    found = checked(tmp_path)
    assert found.returncode == 0
    assert "an end that was cut off would not be noticed" in found.stderr
    assert checked(tmp_path, "--head", str(tmp_path / "sweepid.sqlite")).returncode == 2


def test_heads_are_noted_at_intervals_and_at_the_end(own: Database, tmp_path: Path) -> None:
    file, at = tmp_path / "heads", [0.0]
    heads = AuditHeads(AuditStore(own), file, lambda: at[0])
    with capture_logs() as logs:
        heads.note()
        AuditStore(own).append(ENTRIES)
        heads.note()  # too early
        at[0] = 600.0
        heads.note()
        heads.note(at_end=True)  # nothing new
        AuditStore(own).append(ENTRIES)
        heads.note(at_end=True)
    lines = file.read_text().splitlines()
    assert [line.partition(":")[0] for line in lines] == ["5", "10", "15"]
    assert [log["head"] for log in logs if log["event"] == "audit_head"] == lines
    assert verify(AuditStore(own).links(), heads_in(file.read_text(), "heads"))[0] == 15
    AuditStore(own).append(ENTRIES)
    with capture_logs() as logs:
        AuditHeads(AuditStore(own), tmp_path / "not there" / "heads").note(at_end=True)
    assert [log["event"] for log in logs] == ["audit_head", "audit_head_not_written"]


def test_the_writer_tells_what_it_could_not_write(own: Database) -> None:
    store = AuditStore(own)
    with AuditWriter(store, KeyStore(own)) as writer:
        assert [writer.put(entry).result(30) for entry in ENTRIES] == [6, 7, 8, 9, 10]
        tamper(own, "ALTER TABLE audit RENAME TO gone")
        with pytest.raises(NotAudited, match="OperationalError"):
            writer.put({}).result(30)
        tamper_back = "ALTER TABLE gone RENAME TO audit"
        with own.write() as session:
            session.execute(text(tamper_back))
        last = writer.put({})
    assert last.result(0) == 11  # what waits is written before the end
    with pytest.raises(NotAudited):
        writer.put({}).result(0)


def test_what_is_kept_is_written_as_soon_as_the_database_takes_it(own: Database) -> None:
    store = AuditStore(own)
    with AuditWriter(store, KeyStore(own)) as writer:
        tamper(own, "ALTER TABLE audit RENAME TO gone")
        first, refused = writer.keep({"event": "stop", "why": "first"}), writer.put({})
        with pytest.raises(NotAudited):
            refused.result(30)
        second = writer.keep({"event": "stop", "why": "second"})
        with own.write() as session:
            session.execute(text("ALTER TABLE gone RENAME TO audit"))
        assert (first.result(30), second.result(30)) == (6, 7)
    entries = [one.entry for one in store.documents(after=5)]
    assert [entry["why"] for entry in entries] == ["first", "second"]
    assert all(str(entry["happened"]) <= str(entry["at"]) for entry in entries)
    assert verify(store.links())[0] == 7


def test_what_the_database_does_not_take_before_the_end_is_in_the_log(own: Database) -> None:
    with capture_logs() as logs, AuditWriter(AuditStore(own), KeyStore(own)) as writer:
        tamper(own, "ALTER TABLE audit RENAME TO gone")
        never = writer.keep({"event": "stop", "why": "smoke"})
    with pytest.raises(NotAudited, match="the service ended"):
        never.result(0)
    assert [log["entry"]["why"] for log in logs if log["event"] == "not_audited"] == ["smoke"]


def test_the_commands(own: Database, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = ("--data-dir", str(tmp_path))
    made = sweepid("people", "add-key", "anna", "--role", "operator", "--days", "30", *here)
    assert made.returncode == 0, made.stderr
    key = made.stdout.strip()
    for name, role in (("local", "viewer"), (" ", "viewer"), ("otto", "boss")):
        with pytest.raises(BadInput, match=r"^NAME: |^--role: "):
            add_key(name, role, 30, data_dir=tmp_path)
    with pytest.raises(BadInput, match=r"^--scope: 'fly' is not one of read, "):
        add_key("otto", "viewer", 30, ["read", "fly"], data_dir=tmp_path)
    with pytest.raises(Conflict, match="anna"):
        add_key("anna", "viewer", 30, data_dir=tmp_path)
    export_audit(tmp_path / "audit.jsonl", data_dir=tmp_path)
    lines = [json.loads(line) for line in (tmp_path / "audit.jsonl").read_text().splitlines()]
    assert verify((line["number"], line["entry"], line["sha256"]) for line in lines)[0] == 6
    assert json.loads(lines[-1]["entry"])["event"] == "key added"
    assert key not in (tmp_path / "audit.jsonl").read_text()
    capsys.readouterr()
    list_people(data_dir=tmp_path)
    listed = json.loads(capsys.readouterr().out)
    assert (listed["name"], listed["role"], listed["trouble"]) == ("anna", "operator", "")
    tamper(own, "UPDATE audit SET entry = replace(entry, 'p2', 'p9') WHERE number = 3")
    broken = sweepid("audit", "verify", *here)
    assert (broken.returncode, broken.stdout) == (1, "")
    assert broken.stderr.startswith("sweepid: audit entry 3: ")


def test_without_a_login_it_is_local(tmp_path: Path, profile: Path) -> None:
    with serving(tmp_path, profile) as url, calling(url, "no key at all") as http:
        assert http.post("/api/v1/campaigns", json={"plan_id": 5}).status_code == 404
        foreign = http.post("/api/v1/campaigns", headers={"Origin": "http://evil.example"})
        assert foreign.status_code == 403
        stopped = http.get("/api/v1/stop").json()["port"]
        http.post(f"http://127.0.0.1:{stopped}/stop", params={"by": "anna", "why": "here"})
        nobody = http.post("/api/v1/login", json={"name": "anna", "password": "a horse and a battery"})
        assert (nobody.status_code, "login: false" in nobody.text) == (409, True)
        items = http.get("/api/v1/audit").json()["items"]
    assert [(one["entry"]["event"], one["entry"]["actor"]) for one in items[:3]] == [
        ("request", LOCAL),
        ("outcome", LOCAL),
        ("outcome", "unknown"),
    ]
    assert "evil.example" in items[2]["entry"]["why"]
    with open_database(f"sqlite:///{tmp_path / 'data' / 'sweepid.sqlite'}") as database:
        links = list(AuditStore(database).links())
    assert verify(links)[0] == 5
    heads = heads_in((tmp_path / "data" / "audit-heads.txt").read_text(), "heads")
    assert verify(links, heads) == heads[-1]  # the last one at the end of the service
    assert f'"{heads[-1][0]}:{heads[-1][1]}"' in (tmp_path / "service.log").read_text()
    by_the_stop_process = json.loads(links[3][1])
    assert {name: by_the_stop_process[name] for name in ("event", "way", "by", "actor", "address")} == {
        **{"event": "stop", "way": "stop process", "by": "anna"},
        **{"actor": "anybody", "address": "127.0.0.1"},
    }
    assert '"no_login"' in (tmp_path / "service.log").read_text()
