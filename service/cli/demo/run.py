"""The main task from end to end: plan, measure, identify, diagnose, report; all by the REST API of real processes."""

import json
import shutil
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from service.cli.demo.cell import CELL, PROFILE, ROBOT, virtual_cell
from service.cli.demo.hidden import SCENARIO as HIDING
from service.cli.demo.hidden import Found, find_hidden
from service.cli.demo.operator import Operator
from service.cli.demo.screen import Screen
from service.cli.demo.tracking import drive_path
from service.cli.demo.truth import compare
from service.model.configuration import read_robot
from service.model.errors import BadInput
from service.model.geometry.cell import read_cell
from service.model.results.estimate import Estimate
from service.planning.documents import PlanRequest
from service.planning.pose_choice import workspace_grid
from service.report import Content, axes_of, content_of, estimate_page
from service.report.benefit import Benefit, benefit, benefit_section
from service.store.files.bundle import Bundle, read_bundle
from service.web.client import Json

SCENARIO = Path("config/scenarios/max100-full.yaml")

REQUEST: Json = {
    "cell": CELL.stem,
    "axes": ["joint_1", "joint_2", "joint_3"],
    "varied": ["joint_2", "joint_3"],
    "modes": "one_host_streamed",
    # known from a frequency-response measurement of the CNC before a campaign (the paper's section 4.2), Hz
    "locked_rotor": {"joint_1": 5.0, "joint_2": 9.5, "joint_3": 13.0},
}


@dataclass(frozen=True)
class Outcome:
    """The results of the demo."""

    content: Content
    found: Found
    worth: Benefit
    report: Path
    bundle: Path


def run_demo(out: Path, seed: int, poses: int, screen: Screen) -> Outcome:
    """Run the demo in the folder `out`. In any case, the machine is stopped and the processes are ended."""
    for path in (SCENARIO, HIDING, ROBOT, CELL, PROFILE):
        if not path.is_file():
            raise BadInput(str(path), "not found; the demo runs in the folder that holds config/")
    out = out.absolute()
    _clear(out)
    robot, cell = read_robot(ROBOT), read_cell(CELL)
    request = REQUEST | {"poses": poses}
    screen.doing("starting the virtual machine and the service")
    with virtual_cell(out, robot, SCENARIO, "--seed", str(seed)) as machine:
        client = machine.client
        screen.doing("planning")
        plan = client.add_plan(request | {"robot_id": machine.robot_id})
        campaign_id = int(client.add_campaign(plan["id"])["id"])
        screen.doing("measuring")
        Operator(client, screen.progress, screen.say).run(campaign_id)

        screen.doing("collecting estimates and recordings")
        revisions = client.estimates(campaign_id)
        client.export_bundle(campaign_id, out / "bundle.zip")
    with zipfile.ZipFile(out / "bundle.zip") as archive:
        archive.extractall(out / "bundle")
    (out / "bundle.zip").unlink()

    found = find_hidden(out / "hidden", robot, cell, seed, screen)

    screen.doing("comparing with the truth and writing the report")
    wanted = PlanRequest.model_validate(request | {"robot_id": machine.robot_id})
    workspace = workspace_grid(robot, wanted, cell)
    measured = read_bundle(out / "bundle")
    worth = benefit(measured.robot, measured.sweeps, str(out / "bundle"))  # before the truth is read
    tracking = drive_path(measured, SCENARIO, out / "path.json")
    worth = worth.model_copy(update={"tracking": tracking})
    content = _content(measured, revisions, workspace, seed)
    axes = axes_of(content)
    truth = compare(content, axes, SCENARIO, out / "poses.json")
    columns = tuple(axis.joint for axis in axes)
    subtitle = (
        f"{content.subtitle} Then a second machine with a hidden effect in {found.joint}, revealed "
        f"after its diagnosis: {found.description}. {found.judgement} Last, the benefit of the estimate of "
        "the first machine."
    )
    content = replace(content, subtitle=subtitle, truth=truth, truth_columns=columns, diagnosis=found.diagnosis)
    report = out / "report.html"
    page = estimate_page(content)
    benefit_section(page, worth)
    report.write_text(page.html(), encoding="utf-8")
    (out / "estimate.json").write_text(json.dumps(revisions[-1]["document"], indent=2) + "\n", encoding="utf-8")
    (out / "diagnosis.json").write_text(json.dumps(found.document, indent=2) + "\n", encoding="utf-8")
    (out / "benefit.json").write_text(worth.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return Outcome(content, found, worth, report, out / "bundle")


def _clear(out: Path) -> None:
    """Remove the files of an earlier demo from its folder, and no others."""
    out.mkdir(parents=True, exist_ok=True)
    for data in (out / "data", out / "hidden" / "data"):
        if (data / "sweepid.sqlite").is_file():
            shutil.rmtree(data)
    if (out / "bundle" / "bundle.json").is_file():
        shutil.rmtree(out / "bundle")


def _content(bundle: Bundle, revisions: list[Json], workspace: np.ndarray, seed: int) -> Content:
    sweeps = {sweep.spec.id: sweep for sweep in bundle.sweeps}
    estimates = [Estimate.read(entry["document"], f"estimate {entry['revision']}") for entry in revisions]
    return content_of(
        bundle.robot,
        estimates[-1],
        [sweep.spec for sweep in bundle.sweeps],
        lambda spec: sweeps[spec.id],
        f"Demo on a virtual machine (scenario {SCENARIO.stem}, seed {seed}), measured over CANopen through "
        "the service: elastic drive trains, friction on motor and load side, cogging and noise.",
        workspace=workspace,
        revisions=[(entry["revision"], one.base_parameters) for entry, one in zip(revisions, estimates, strict=True)],
    )
