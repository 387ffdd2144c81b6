"""A bundle goes in, its sweeps are identified, and the same bundle comes out; what cannot be read leaves nothing."""

import io
import json
import sys
import zipfile
from pathlib import Path
from typing import Any

import httpx
import psutil
import pyarrow.parquet as pq
import pytest

from service.store.files.bundle import read_bundle
from tests.unit.service.api.conftest import ZIP, packed

pytestmark = pytest.mark.slow


def all_of(http: httpx.Client) -> list[int]:
    """Their ids; what they say changes while other tests' bundles are identified."""
    return [item["id"] for item in http.get("/campaigns", params={"limit": 200}).json()["items"]]


def first_events(http: httpx.Client, campaign: int, count: int, **options: Any) -> list[tuple[int, str, Any]]:
    """(id, kind, document) of the first events of a campaign's stream; what the machine tells stands between them."""
    found: list[tuple[int, str, Any]] = []
    fields: dict[str, str] = {}
    with http.stream("GET", "/events", **options) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        for line in answer.iter_lines():
            name, _, value = line.partition(": ")
            fields[name] = value
            if not line and "data" in fields:
                document = json.loads(fields["data"])
                assert document["campaign_id"] in (campaign, None)
                if document["campaign_id"] == campaign:
                    found.append((int(fields["id"]), fields["event"], document))
                if len(found) == count:
                    break
            if not line:
                fields = {}
    return found


def test_every_sweep_makes_a_revision(http: httpx.Client, campaign: int) -> None:
    told = http.get(f"/campaigns/{campaign}").json()
    assert told["sweeps"] == {"identified": 3}
    assert (told["progress"]["done"], told["progress"]["total"]) == (3, 3)
    revisions = http.get(f"/campaigns/{campaign}/estimates").json()["items"]
    assert [revision["revision"] for revision in revisions] == [1, 2, 3]
    pages = [http.get(f"/campaigns/{campaign}/estimates?limit=2&after={after}").json() for after in (0, 2)]
    assert [(page["items"], page["next"]) for page in pages] == [(revisions[:2], 2), (revisions[2:], None)]
    latest = http.get(f"/campaigns/{campaign}/estimates/latest").json()
    assert latest == revisions[-1] == http.get(f"/campaigns/{campaign}/estimates/3").json()
    inertia = {point["sweep"]: point["value"] for point in latest["document"]["axes"]["joint_1"]["inertia"]}
    assert inertia == pytest.approx({"0001": 275.0, "0002": 300.0, "0003": 325.0}, rel=0.02)


def test_a_recording_is_downloaded_as_parquet(http: httpx.Client, campaign: int) -> None:
    recording = http.get(f"/campaigns/{campaign}/sweeps/2/recording").json()
    file = http.get(f"/campaigns/{campaign}/sweeps/2/recording/file")
    assert file.headers["content-type"] == "application/vnd.apache.parquet"
    assert file.headers["x-content-sha256"] == recording["sha256"]
    table = pq.read_table(io.BytesIO(file.content))
    assert table.num_rows == recording["samples"] == 1250
    assert {"time", "effort", "velocity", "position"} <= set(table.column_names)


def test_a_recording_that_was_changed_is_not_handed_out(http: httpx.Client, campaign: int, folder: Path) -> None:
    recording = http.get(f"/campaigns/{campaign}/sweeps/3/recording").json()
    path = folder / "data" / recording["path"]
    content = path.read_bytes()
    try:
        for changed in (content[:500] + bytes([content[500] ^ 1]) + content[501:], content[:-1], None):
            path.unlink(missing_ok=True)
            if changed is not None:
                path.write_bytes(changed)
            answer = http.get(f"/campaigns/{campaign}/sweeps/3/recording/file")
            assert answer.status_code == 422
            (error,) = answer.json()["errors"]
            assert str(path) in error["pointer"]
            assert error["reason"] == (
                "recording file is missing"
                if changed is None
                else f"recording file was changed, SHA-256 is not {recording['sha256']}"
            )
    finally:
        path.write_bytes(content)
    assert http.get(f"/campaigns/{campaign}/sweeps/3/recording/file").content == content


def test_what_goes_out_is_what_came_in(http: httpx.Client, campaign: int, bundle: Path, tmp_path: Path) -> None:
    answer = http.get(f"/campaigns/{campaign}/bundle")
    assert answer.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        archive.extractall(tmp_path)
    given, got = read_bundle(bundle), read_bundle(tmp_path)
    assert [sweep.spec for sweep in got.sweeps] == [sweep.spec for sweep in given.sweeps]
    for one, other in zip(given.sweeps, got.sweeps, strict=True):
        assert (one.recording.effort == other.recording.effort).all()


def test_events_are_taken_up_after_the_last_one_seen(http: httpx.Client, campaign: int) -> None:
    events = first_events(http, campaign, 4, params={"after": 0, "campaign": campaign})
    numbers = [number for number, _, _ in events]
    assert numbers == sorted(set(numbers)) == [document["id"] for _, _, document in events]
    rest = first_events(http, campaign, 2, params={"campaign": campaign}, headers={"Last-Event-ID": str(numbers[1])})
    assert rest == events[2:]


def _archive(kind: int, *names: str) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", kind) as archive:
        for name in names:
            archive.writestr(name, b"x" * 1000)
    return content.getvalue()


def _damaged(kind: int) -> bytes:
    content = bytearray(_archive(kind, "bundle.json"))
    start = 30 + len("bundle.json") + 9  # local header, name, properties of an LZMA stream
    content[start : start + 12] = b"\xff" * 12
    return bytes(content)


@pytest.mark.parametrize(
    "content",
    [
        _archive(zipfile.ZIP_STORED, "a" * 300),
        _archive(zipfile.ZIP_STORED, "sweeps", "sweeps/0001.csv"),
        _archive(zipfile.ZIP_STORED, "../../outside.csv"),
        _damaged(zipfile.ZIP_LZMA),
        _damaged(zipfile.ZIP_BZIP2),
        _damaged(zipfile.ZIP_DEFLATED),
    ],
    ids=["long name", "file and folder", "way out", "lzma", "bzip2", "deflate"],
)
def test_an_archive_that_cannot_be_unpacked_is_refused(http: httpx.Client, folder: Path, content: bytes) -> None:
    refused = http.post("/bundles", content=content, headers=ZIP)
    assert refused.status_code == 422, refused.text
    assert "bundle" in refused.json()["detail"]
    assert "import-" not in refused.text  # our folders are nobody's business
    assert [path.name for path in folder.rglob("outside*")] == []
    assert list((folder / "data" / "transfer").iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("key", [{}, {"Idempotency-Key": "a large body"}], ids=["alone", "with a key"])
def test_a_large_body_does_not_make_the_service_grow(served: str, served_in: Path, key: dict[str, str]) -> None:
    (process,) = (each for each in psutil.Process().children() if str(served_in) in " ".join(each.cmdline()))

    def most_memory() -> int:
        """kB, since it began."""
        lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

    with httpx.Client(base_url=f"{served}/api/v1", timeout=120, trust_env=False) as http:
        before, memory = all_of(http), most_memory()
        refused = http.post("/bundles", content=(bytes(2**20) for _ in range(200)), headers=ZIP | key)
        assert refused.status_code == 422, refused.text
        assert most_memory() - memory < 100 * 2**10
        assert all_of(http) == before
    assert list((served_in / "data" / "transfer").iterdir()) == []


def test_a_request_sent_twice_is_done_once_and_a_refused_one_does_not_use_up_its_key(
    http: httpx.Client, bundle: Path
) -> None:
    before, headers = len(all_of(http)), ZIP | {"Idempotency-Key": "import-1"}
    assert http.post("/bundles", content=b"no zip", headers=headers).status_code == 422
    content = packed(bundle)
    once, twice = (http.post("/bundles", content=content, headers=headers) for _ in range(2))
    assert (once.status_code, twice.status_code) == (201, 201)
    assert twice.content == once.content
    assert twice.headers["etag"] == once.headers["etag"]
    assert twice.headers["location"] == once.headers["location"]
    assert twice.headers["idempotency-replayed"] == "true"
    assert len(all_of(http)) == before + 1
    other = http.post("/bundles", content=content + b"\0", headers=headers)
    assert (other.status_code, "another request" in other.json()["detail"]) == (422, True)


def test_a_command_for_another_version_is_412_and_one_that_does_not_fit_409(http: httpx.Client, campaign: int) -> None:
    etag = http.get(f"/campaigns/{campaign}").headers["etag"]
    other = f'"{int(etag.strip(chr(34))) + 1}"'
    command = f"/campaigns/{campaign}/abort"
    assert http.post(command, headers={"If-Match": other}).status_code == 412
    assert http.post(command, headers={"If-Match": "3"}).status_code == 422
    assert http.post(command, headers={"If-Match": etag}).status_code == 409
    assert http.post(command, headers={"If-Match": "*"}).status_code == 409


@pytest.mark.parametrize(
    ("ending", "kind", "start"),
    [
        ("urdf", "application/xml", "<?xml"),
        ("xml", "application/xml", "<mujoco"),
        ("yaml", "application/yaml", "robot:"),
    ],
)
def test_the_identified_robot_is_downloaded(
    http: httpx.Client, campaign: int, ending: str, kind: str, start: str
) -> None:
    answer = http.get(f"/campaigns/{campaign}/model.{ending}")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith(kind)
    assert f"campaign-{campaign}-model.{ending}" in answer.headers["content-disposition"]
    assert answer.text.startswith(start)
    assert "link_6" in answer.text
