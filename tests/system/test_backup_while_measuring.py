"""A backup that is taken while a campaign measures: what is restored elsewhere is whole and tells the same."""

import sqlite3
from contextlib import closing
from pathlib import Path

from service.client import Json, ServiceClient
from tests.system.rest_bench import (
    PATIENT_LEASE,
    VirtualMachine,
    add_plan,
    run,
    serving,
    until,
    virtual_machine,
)

POSES = 20  # more than are measured until the backup is made, however busy the computer is
BEFORE = 2  # sweeps that are identified before the backup is taken


def moves(machine: VirtualMachine) -> bool:
    return any(abs(axis["velocity"]) > 1e-3 for axis in machine.axes().values())


def command(*arguments: str) -> str:
    """What the console script prints; it ends well."""
    ended = run(*arguments, url="")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def estimates(client: ServiceClient, campaign: int) -> dict[int, Json]:
    """Every revision, without when it was made."""
    found = client.estimates(campaign)
    return {one["revision"]: {name: one[name] for name in ("number", "document")} for one in found}


def in_state(client: ServiceClient, campaign: int, *states: str) -> int:
    return sum(sweep["state"] in states for sweep in client.sweeps(campaign))


def test_what_is_restored_tells_what_the_original_told(tmp_path: Path) -> None:
    old, new, backup = tmp_path / "old", tmp_path / "new", tmp_path / "backup"
    old.mkdir()
    new.mkdir()
    with virtual_machine(tmp_path) as machine:
        with serving(old, machine.profile, PATIENT_LEASE) as service, ServiceClient(service.url) as client:
            campaign = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=POSES))["id"])
            client.start(campaign)
            until(lambda: in_state(client, campaign, "identified") >= BEFORE, f"{BEFORE} sweeps are identified")
            for worker in service.workers():  # so that the backup has a sweep which nobody has identified yet
                worker.suspend()
            until(lambda: in_state(client, campaign, "recorded") > 0 and moves(machine), "an axis moves")
            command("data", "backup", str(backup), "--data-dir", str(service.data))
            assert client.campaign(campaign)["state"] == "running", "the backup was not taken while it measured"
            for worker in service.workers():
                worker.resume()
            client.pause(campaign)
            until(lambda: client.campaign(campaign)["state"] == "paused", "the sweep under way is over")
            until(lambda: in_state(client, campaign, "recorded") == 0, "all that was measured is identified")
            original = estimates(client, campaign)

        command("data", "restore", str(backup), "--data-dir", str(new / "data"))
        assert command("data", "doctor", "--data-dir", str(new / "data")) == ""
        with closing(sqlite3.connect(new / "data" / "sweepid.sqlite")) as database:
            (identified,) = database.execute("SELECT count(*) FROM sweep WHERE state = 'identified'").fetchone()
        with serving(new, machine.profile, PATIENT_LEASE) as service, ServiceClient(service.url) as client:
            assert client.campaign(campaign)["state"] == "paused"  # nothing moves by itself
            until(lambda: in_state(client, campaign, "recorded") == 0, "all that was recorded is identified")
            measured = in_state(client, campaign, "identified")
            restored = estimates(client, campaign)
            assert len(restored) > identified  # it made some itself
            assert machine.stands()
    assert BEFORE < measured <= len(original)
    assert list(restored) == list(range(1, measured + 1))
    # to the last digit: JSON has every float as it is
    assert restored == {revision: original[revision] for revision in restored}
    assert (
        command("data", "doctor", "--data-dir", str(new / "data")) == ""
    )  # what the restored service added fits as well
