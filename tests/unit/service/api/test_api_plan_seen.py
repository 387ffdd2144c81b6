"""The plan that moves is the plan that was seen: robot, cell and machine of a plan, and the approach to it."""

import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivers.registry import load_profile
from tests.unit.service.api.conftest import opened as service_in
from tests.unit.service.campaigns.formula_drive import FormulaDrive
from tests.unit.service.hosting import CONFIG

PROFILE = CONFIG / "drives" / "virtual-max100.yaml"
JOINTS = tuple(f"joint_{number}" for number in range(1, 7))
WANTED = {"axes": ["joint_1"], "varied": ["joint_2"], "step": 30.0, "poses": 1}
HTTP = httpx.AsyncClient
Opened = Callable[..., AbstractAsyncContextManager[HTTP]]


@pytest.fixture
def drive() -> FormulaDrive:
    return FormulaDrive(JOINTS)


@pytest.fixture
def cells(tmp_path: Path) -> Path:
    """The workshop, and a bench without fence, table and cabinet whose name comes first in the alphabet."""
    folder = tmp_path / "cells"
    folder.mkdir()
    shutil.copy(CONFIG / "cells" / "workshop.yaml", folder)
    (folder / "bench.yaml").write_text("name: bench\n", "utf-8")
    return folder


@pytest.fixture
def opened(tmp_path: Path, drive: FormulaDrive, monkeypatch: pytest.MonkeyPatch) -> Opened:
    """The service in this process, in front of the formula drive."""
    monkeypatch.setattr("service.web.application.open_profile", lambda path: (load_profile(path), drive))

    @asynccontextmanager
    async def open_service(**given: object) -> AsyncIterator[HTTP]:
        async with service_in(tmp_path / "data", PROFILE, **given) as (application, http):
            yield http
            drive.go.set()
            await application.runner.finished()

    return open_service


async def robot_of(http: HTTP) -> int:
    return next(one["id"] for one in (await http.get("/robots")).json()["items"] if one["name"] == "max100-class")


async def planned(http: HTTP, robot: int | None = None, cell: str = "", **typed: str) -> httpx.Response:
    body = WANTED | {"robot_id": robot or await robot_of(http)} | ({"cell": cell} if cell else {})
    return await http.post("/plans", json=body, params=typed)


async def campaign_of(http: HTTP, plan: int) -> int:
    return int((await http.post("/campaigns", json={"plan_id": plan})).json()["id"])


async def test_two_cells_and_no_setting_refuse_to_plan_by_default(opened: Opened, cells: Path) -> None:
    async with opened(cells_dir=cells) as http:
        told = (await http.get("/machines")).json()
        (missing,) = told["missing"]
        assert "set `cell` (SWEEPID_CELL)" in missing
        assert "bench, workshop fit the machine" in missing
        refused = await planned(http)
        assert (refused.status_code, missing in refused.json()["detail"]) == (409, True)
        named = await planned(http, cell="workshop")
        assert (named.status_code, named.json()["confirm"]) == (409, {"cell": "workshop"})


async def test_another_cell_needs_its_name_typed_and_shows_it(opened: Opened, cells: Path) -> None:
    async with opened(cells_dir=cells, cell="workshop") as http:
        assert (await planned(http)).json()["document"]["request"]["cell"] == "workshop"
        refused = await planned(http, cell="bench")
        problem = refused.json()
        assert (refused.status_code, problem["type"]) == (409, "urn:sweepid:problem:needs-confirmation")
        assert problem["confirm"] == {"cell": "bench"}
        assert "the plan is of cell bench, but machine 'machine' has workshop" in problem["detail"]
        assert (await planned(http, cell="bench", confirm_cell="benhc")).status_code == 409
        made = await planned(http, cell="bench", confirm_cell="bench")
        assert made.status_code == 201, made.text
        campaign = await campaign_of(http, made.json()["id"])
        shown = (await http.get(f"/campaigns/{campaign}")).json()["subject"]
        assert (shown["cell"], shown["machine"], shown["confirmed"]) == ("bench", "machine", {"cell": "bench"})
        assert (await http.get(f"/plans/{made.json()['id']}/approvals")).json()["subject"] == shown
        assert (await http.get(f"/campaigns/{campaign}/ahead")).json()["subject"] == shown


async def test_a_start_checks_robot_and_cell_again(opened: Opened, cells: Path, drive: FormulaDrive) -> None:
    async with opened(cells_dir=cells, cell="bench") as http:
        made = (await planned(http)).json()["id"]
        confirmed = (await planned(http, cell="workshop", confirm_cell="workshop")).json()["id"]
        campaigns = [await campaign_of(http, plan) for plan in (made, confirmed)]
    async with opened(cells_dir=cells, cell="workshop") as http:
        before = list(drive.trace)
        refused = await http.post(f"/campaigns/{campaigns[0]}/start")
        assert refused.status_code == 409
        assert "the plan is of cell bench, but machine 'machine' has workshop" in refused.json()["detail"]
        assert "make the plan again" in refused.json()["detail"]
        assert not any(step.startswith("enable") for step in drive.trace[len(before) :])
        started = await http.post(f"/campaigns/{campaigns[1]}/start")
        assert started.status_code == 200, started.text


async def ahead_of(http: HTTP, campaign: int) -> dict[str, Any]:
    answer = await http.get(f"/campaigns/{campaign}/ahead")
    assert answer.status_code == 200, answer.text
    return answer.json()


async def test_the_approach_from_where_the_axes_stand_is_shown(opened: Opened, drive: FormulaDrive) -> None:
    drive.position["joint_3"] = -2.2038  # rad, -126.27 deg
    async with opened() as http:
        campaign = await campaign_of(http, (await planned(http)).json()["id"])
        ahead = await ahead_of(http, campaign)
        assert (ahead["trouble"], ahead["refused"]) == ("", "")
        assert ahead["positions"]["joint_3"] == -2.2038
        assert ahead["at"]
        assert ahead["range"]["joint_3"][0] == -2.2038
        assert "joint_3" in {leg["joint"] for leg in ahead["approach"]}
        assert ahead["approach_time"] > 2.0 / 0.1 / 1.01


async def test_a_start_is_refused_if_an_axis_has_left_what_was_shown(opened: Opened, drive: FormulaDrive) -> None:
    async with opened() as http:
        campaign = await campaign_of(http, (await planned(http)).json()["id"])
        seen = {"seen": (await ahead_of(http, campaign))["range"]}
        drive.position["joint_3"] = -2.2038
        refused = await http.post(f"/campaigns/{campaign}/start", json=seen)
        assert refused.status_code == 409
        assert "joint_3 stands at -2.2038 rad, outside of" in refused.json()["detail"]
        assert "look at the motion again, then start" in refused.json()["detail"]
        assert not any(step.startswith("enable") for step in drive.trace)
        assert (await http.get(f"/campaigns/{campaign}")).json()["state"] == "planned"
        drive.position["joint_3"] = 1e-3  # within the tolerance of a pose
        started = await http.post(f"/campaigns/{campaign}/start", json=seen)
        assert started.status_code == 200, started.text


async def test_without_drives_the_approach_is_not_known(opened: Opened, drive: FormulaDrive) -> None:
    async with opened() as http:
        campaign = await campaign_of(http, (await planned(http)).json()["id"])
        drive.silent = True
        await http.get("/drives")
        ahead = await ahead_of(http, campaign)
        assert (ahead["trouble"], ahead["approach"], ahead["positions"], ahead["at"]) == (
            "the drives are not connected: no drive answers",
            [],
            {},
            None,
        )
        assert "joint_1" in ahead["range"]
        drive.position |= {"joint_2": ahead["range"]["joint_2"][0], "joint_3": -2.2038}
        seen = {"seen": ahead["range"]}  # the start connects, and finds an axis of which nobody was told
        refused = await http.post(f"/campaigns/{campaign}/start", json=seen)
        assert refused.status_code == 409
        assert "joint_3 would move from -2.2038 to 0.0000 rad, which was not shown" in refused.json()["detail"]


async def test_while_a_campaign_runs_no_approach_is_computed(opened: Opened, drive: FormulaDrive) -> None:
    async with opened() as http:
        plan = (await planned(http)).json()["id"]
        first, second = [await campaign_of(http, plan) for _ in range(2)]
        drive.hold = 0
        seen = {"seen": (await ahead_of(http, first))["range"]}
        assert (await http.post(f"/campaigns/{first}/start", json=seen)).status_code == 200
        for path in (f"/campaigns/{second}/ahead", f"/plans/{plan}/ahead"):
            answer = await http.get(path)
            assert (answer.status_code, f"campaign {first} is running" in answer.json()["detail"]) == (409, True)
