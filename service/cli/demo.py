"""The demo: a virtual machine and the service as real processes, one complete campaign by the REST API, a report.

It is a normal client. In addition it reads the true parameters of the virtual robot, only after the last estimate.
"""

import json
import math
import secrets
import shutil
import signal
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TaskID, TextColumn
from rich.table import Table

from service import BadInput, SweepidError
from service.cli.report_pages import bundle_report
from service.cli.terminal import print_result
from service.cli.virtual_cell import CELL, PROFILE, ROBOT, Operator, VirtualCell, answer_of_drive, virtual_cell
from service.diagnosis.summary import judged_on
from service.identification.model import lock
from service.identification.model.base_parameters import base_parameters
from service.model import Array, Robot
from service.model.configuration import Cell, read_cell, read_robot
from service.model.results.diagnosis import AxisDiagnosis, Diagnosis, RigidParameter
from service.model.results.estimate import Estimate
from service.planning.documents import PlanRequest
from service.planning.poses import workspace_grid
from service.report.benefit.benefit import Benefit, FollowingError, Tracking, benefit, feed_forward
from service.report.benefit.section import benefit_section, sentence
from service.report.campaign import campaign_page
from service.report.content import Content, Drive, ReportedAxis, TruthRow, axes_of, content_of
from service.report.diagnosis import diagnosis_section
from service.report.gap_figures import plain
from service.store.files.bundle import Bundle, read_bundle
from service.web.client import Json, ServiceClient

SCENARIO = Path("config/scenarios/max100-full.yaml")
HIDING = Path("config/scenarios/max100-as-modelled.yaml")


@dataclass(frozen=True)
class Screen:
    """Output of the current action, of the campaign at each event, and of notes."""

    doing: Callable[[str], None]
    progress: Callable[[Json], None]
    say: Callable[[str], None]


@dataclass(frozen=True)
class Found:
    """`document` of the last diagnosis from the API; `hidden` is the later output of `sweepid drive truth`."""

    joint: str
    document: Json
    experiments: tuple[str, ...]  # run because the diagnosis proposed them
    model: int | None  # accepted revision
    hidden: Json

    @property
    def diagnosis(self) -> Diagnosis:
        return Diagnosis.read(self.document, "diagnosis")

    @property
    def axis(self) -> AxisDiagnosis:
        return self.diagnosis.axes[self.joint]

    @property
    def named(self) -> list[str]:
        return [effect.effect for effect in self.axis.effects] if self.axis.verdict == "named" else []

    @property
    def right(self) -> bool:
        """Whether the hidden effect was named, and no other."""
        return self.named == [self.hidden["effect"]]

    @property
    def off_from_cad(self) -> RigidParameter | None:
        """The link parameter that differs most from CAD, for a hidden gravity error within the model's prior.

        A diagnosis starts with link parameters fitted within the robot's prior; only a part that exceeds this
        prior is a named effect.
        """
        if self.hidden["effect"] != "gravity_error" or self.axis.verdict != "none":
            return None
        off = [(_deviation(one), one) for one in self.axis.rigid_model if one.name != "viscous_friction"]
        deviation, found = max(off, key=lambda pair: pair[0], default=(0.0, None))
        # 4 standard deviations: exceeded by one of 20 parameters by chance in 1 of 800 diagnoses
        return found if deviation >= 4.0 else None

    @property
    def description(self) -> str:
        """The hidden effect, in words."""
        units = {name: value.unit for effect in self.axis.effects for name, value in effect.parameters.items()}
        parameters = self.hidden["parameters"].items()
        sizes = ", ".join(f"{plain(name)} {value:.4g} {units.get(name, '')}".rstrip() for name, value in parameters)
        return plain(self.hidden["effect"]) + (f" ({sizes})" if sizes else "")

    @property
    def judgement(self) -> str:
        """Whether the diagnosis was correct, in a sentence."""
        if self.right:
            accepted = f"accepted as revision {self.model} of the model" if self.model else "but not accepted"
            return f"Right; {accepted}."
        if self.named:
            return f"Wrong: {', '.join(map(plain, self.named))} was named."
        if self.hidden["effect"] in self.axis.candidates:
            return "Not decided: it is among the candidates."
        if off := self.off_from_cad:
            return (
                f"Not named, but fitted: it is as small as CAD's own uncertainty. {off.name} is {off.value:.4g} "
                f"+/- {off.std:.2g}, CAD says {off.nominal:.4g}."
            )
        return f"Not found: the verdict is {self.axis.verdict}."


@dataclass(frozen=True)
class DemoOutcome:
    """The results of the demo."""

    content: Content
    found: Found
    worth: Benefit
    report: Path
    bundle: Path


def show_demo(out: Path, seed: int | None, poses: int) -> None:
    """Run the demo with its progress on stderr, and print what was found. `seed` None: a random one."""
    seed = secrets.randbelow(1_000_000) if seed is None else seed
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    words = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("{task.fields[detail]}"),
    )
    try:
        with Progress(*columns, console=words) as bars:
            outcome = run_demo(out, seed, poses, _screen(bars, bars.add_task("", total=None, detail="")))
    except KeyboardInterrupt:
        raise SweepidError("interrupted; the machine was stopped and all processes have ended") from None
    console = Console()
    _print_estimate(outcome, console)
    _print_diagnosis(outcome.found, console)
    _print_worth(outcome, console)
    console.print(f"Report: {outcome.report}", soft_wrap=True, highlight=False)
    console.print(f"Bundle: {outcome.bundle}  (sweepid identify {outcome.bundle})", soft_wrap=True, highlight=False)
    console.print(f"The same again: --seed {seed}", highlight=False)


def _screen(bars: Progress, bar: TaskID) -> Screen:
    def progress(campaign: Json) -> None:
        done = campaign["progress"]
        detail = _detail(campaign)
        bars.update(bar, total=done["total"], completed=done["done"], detail=detail)

    def doing(what: str) -> None:
        bars.update(bar, description=what, detail="")

    def say(note: str) -> None:
        bars.console.print(note, style="yellow", highlight=False)

    return Screen(doing, progress, say)


def _detail(campaign: Json) -> str:
    """Remaining time, axis and pose."""
    current, remaining = campaign["progress"]["current"], campaign["progress"]["remaining"]
    if current is None:
        return "identifying the last sweeps" if campaign["state"] == "measured" else ""
    pose = ", ".join(f"{math.degrees(position):.0f}°" for position in current["spec"]["pose"])
    left = "" if remaining is None else f"{int(remaining // 60)}:{int(remaining % 60):02d} left, "
    return f"{left}{current['spec']['axis']} at ({pose})"


def run_demo(out: Path, seed: int, poses: int, screen: Screen) -> DemoOutcome:
    """Run the demo in the folder `out`. In any case, the machine is stopped and the processes are ended."""
    request: Json = {
        "cell": CELL.stem,
        "axes": ["joint_1", "joint_2", "joint_3"],
        "varied": ["joint_2", "joint_3"],
        "modes": "one_host_streamed",
        # known from a frequency-response measurement of the CNC before a campaign (the paper's section 4.2), Hz
        "locked_rotor": {"joint_1": 5.0, "joint_2": 9.5, "joint_3": 13.0},
        "poses": poses,
        "move_velocity": 0.5,
    }
    for path in (SCENARIO, HIDING, ROBOT, CELL, PROFILE):
        if not path.is_file():
            raise BadInput(str(path), "not found; the demo runs in the folder that holds config/")
    out = out.absolute()
    _clear(out)
    robot, cell = read_robot(ROBOT), read_cell(CELL)
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
        identities = {axis["joint"]: axis["identity"] for axis in client.drives()["axes"] if axis["identity"]}
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
    content = _content(measured, revisions, seed)
    in_cell = replace(content, workspace=workspace)
    axes = axes_of(in_cell)
    measures = Counter(spec.axis for spec in content.specs)
    drives = tuple(Drive(joint, **identities[joint], sweeps=measures[joint]) for joint in identities if measures[joint])
    truth = compare(in_cell, axes, SCENARIO, out / "poses.json")
    content = replace(content, truth=truth, truth_columns=tuple(axis.joint for axis in axes))
    report = out / "report.html"
    page = campaign_page(
        replace(bundle_report(measured, str(out / "bundle"), content.subtitle), drives=drives),
        measured.robot.joints,
        content.estimate,
        content,
    )
    diagnosis_section(
        page,
        found.diagnosis,
        f"Not the machine of the estimate above, but a second virtual one ({HIDING.stem}) that hides an effect in "
        f"{found.joint}. After its diagnosis it was revealed: {found.description}. {found.judgement}",
    )
    benefit_section(page, worth)
    report.write_text(page.html(), encoding="utf-8")
    (out / "estimate.json").write_text(json.dumps(revisions[-1]["document"], indent=2) + "\n", encoding="utf-8")
    (out / "diagnosis.json").write_text(json.dumps(found.document, indent=2) + "\n", encoding="utf-8")
    (out / "benefit.json").write_text(worth.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return DemoOutcome(content, found, worth, report, out / "bundle")


def _clear(out: Path) -> None:
    """Remove the files of an earlier demo from its folder, and no others."""
    out.mkdir(parents=True, exist_ok=True)
    for data in (out / "data", out / "hidden" / "data"):
        if (data / "sweepid.sqlite").is_file():
            shutil.rmtree(data)
    if (out / "bundle" / "bundle.json").is_file():
        shutil.rmtree(out / "bundle")


def _content(bundle: Bundle, revisions: list[Json], seed: int) -> Content:
    sweeps = {sweep.spec.id: sweep for sweep in bundle.sweeps}
    estimates = [Estimate.read(entry["document"], f"estimate {entry['revision']}") for entry in revisions]
    return content_of(
        bundle.robot,
        estimates[-1],
        [sweep.spec for sweep in bundle.sweeps],
        lambda spec: sweeps[spec.id],
        f"Demo on a virtual machine (scenario {SCENARIO.stem}, seed {seed}), measured over CANopen through "
        "the service: elastic drive trains, friction on motor and load side, cogging and noise.",
        revisions=[(entry["revision"], one.base_parameters) for entry, one in zip(revisions, estimates, strict=True)],
    )


def find_hidden(folder: Path, robot: Robot, cell: Cell, seed: int, screen: Screen) -> Found:
    """Measure and diagnose the machine for this seed; processes and files as in `virtual_cell`."""
    folder.mkdir(exist_ok=True)
    screen.doing("starting a machine that hides something")
    with virtual_cell(folder, robot, HIDING, "--seed", str(seed), "--hide", str(seed)) as machine:
        joint = machine.machine.hidden_in
        diagnosis, experiments = _diagnosed(machine, joint, cell, screen)
        model = _accepted(machine.client, diagnosis, joint)
    hidden: Json = json.loads(answer_of_drive("truth", str(HIDING), "--hide", str(seed)))
    return Found(joint, diagnosis["document"], experiments, model, hidden)


def _print_estimate(outcome: DemoOutcome, console: Console) -> None:
    print_result(outcome.content.estimate, console)
    table = Table(title="Errors against the truth in percent: median (95th percentile)")
    table.add_column("")
    for joint in outcome.content.truth_columns:
        table.add_column(joint, justify="right")
    for row in outcome.content.truth:
        table.add_row(row.label, *row.figures)
    console.print(table)


def _print_worth(outcome: DemoOutcome, console: Console) -> None:
    console.print("\n[bold]What you gain[/bold]", highlight=False)
    if outcome.worth.axes:
        console.print(sentence(outcome.worth), highlight=False)
    for joint, why in outcome.worth.not_judged.items():
        console.print(f"Not judged: {joint} {why}.", highlight=False)


def _print_diagnosis(found: Found, console: Console) -> None:
    axis = found.axis
    gap, floor = axis.gap, axis.gap.noise_floor_rms
    asked = f" after {', '.join(map(plain, found.experiments))}" if found.experiments else ""
    console.print(f"\n[bold]A machine that hides something in {found.joint}[/bold]", highlight=False)
    console.print(f"Found{asked}: {axis.summary}", highlight=False)
    console.print(
        f"Gap {judged_on(gap)}: {gap.before_rms:.3g} N m before, "
        f"{gap.after_rms:.3g} N m after, noise floor {'–' if floor is None else f'{floor:.3g} N m'}.",
        highlight=False,
    )
    console.print(f"Hidden: {found.description}.", highlight=False)
    console.print(f"[bold]{found.judgement}[/bold]", highlight=False)


PERSON = "operator of the demo"


def _deviation(one: RigidParameter) -> float:
    """Difference from CAD, in standard deviations of the identified value."""
    return abs(one.value - one.nominal) / one.std if one.nominal is not None and one.std else 0.0


def _diagnosed(machine: VirtualCell, joint: str, cell: Cell, screen: Screen) -> tuple[Json, tuple[str, ...]]:
    """The last diagnosis, and the experiments that it proposed and that were run."""
    request = {
        "kind": "diagnosis",
        "varied": ["joint_2", "joint_3"],
        "poses": 3,
        "blocks": ["forward_slow", "wide"],  # other blocks are measured when the diagnosis proposes them
        "move_velocity": 0.5,
        "robot_id": machine.robot_id,
        "cell": cell.name,
        "axes": [joint],
    }
    client, operator = machine.client, Operator(machine.client, screen.progress, screen.say)
    screen.doing(f"measuring {joint} for its diagnosis")
    plan = client.add_plan(request)
    campaign = int(client.add_campaign(plan["id"])["id"])
    operator.run(campaign)
    screen.doing("diagnosing")
    diagnosis = _done(client, client.add_diagnosis([campaign], [joint]))
    experiments: list[str] = []
    while wanted := _axis(diagnosis, joint).next_experiment:
        if wanted.weighs or not wanted.sweeps or len(experiments) == 2:
            break
        experiments.append(wanted.kind)
        screen.say(f"the diagnosis asks: {wanted.reason}; approved")
        screen.doing(f"next experiment: {plain(wanted.kind)}")
        operator.watch(int(client.approve_experiment(diagnosis["id"], joint, PERSON)["id"]))
        screen.doing("diagnosing with the new sweeps")
        diagnosis = _done(client, _continued(client, diagnosis["id"]))
    return diagnosis, tuple(experiments)


def _continued(client: ServiceClient, parent: int) -> Json:
    """The diagnosis that the service started after the experiment."""
    for event in client.events():
        if event["kind"] == "diagnosis":
            found = client.diagnosis(event["data"]["diagnosis"])
            if found["parent"] == parent:
                return found
    raise SweepidError("the event stream ended before the diagnosis was done")


def _done(client: ServiceClient, diagnosis: Json) -> Json:
    found = client.diagnosed(diagnosis["id"])
    if found["state"] != "done":
        raise SweepidError(f"diagnosis {found['id']} failed: {found['cause']}")
    return found


def _axis(diagnosis: Json, joint: str) -> AxisDiagnosis:
    return Diagnosis.read(diagnosis["document"], f"diagnosis {diagnosis['id']}").axes[joint]


def _accepted(client: ServiceClient, diagnosis: Json, joint: str) -> int | None:
    """The model's revision, if there is a named effect to accept."""
    axis = _axis(diagnosis, joint)
    if axis.verdict != "named" or set(axis.rolled_back) >= {effect.effect for effect in axis.effects}:
        return None
    return int(client.accept_model(diagnosis["id"], PERSON, [joint])["revision"])


class _Followed(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    cad: dict[str, FollowingError]
    identified: dict[str, FollowingError]


def drive_path(measured: Bundle, scenario: Path, scratch: Path) -> Tracking:
    """The same path on the virtual machine's mechanics, with torque feed-forward of CAD and of the estimate.

    `scratch`: a file for the path, removed afterwards.
    """
    gain = 10.0  # 1/s, of the position controllers: 0.6 m/min per mm, usual for elastic gears
    wanted = feed_forward(measured.robot, measured.sweeps)
    motion = wanted.motion
    path = {
        "gain": gain,
        "position": motion.position.tolist(),
        "velocity": motion.velocity.tolist(),
        "feed_forwards": {"cad": wanted.cad.tolist(), "identified": wanted.identified.tolist()},
    }
    scratch.write_text(json.dumps(path), encoding="utf-8")
    found = _Followed.model_validate_json(answer_of_drive("follow", str(scenario), str(scratch)))
    scratch.unlink()
    moved = {sweep.spec.axis for sweep in measured.sweeps}
    return Tracking(
        duration=(len(motion.position) - 1) / 1000,
        top_speed=float(np.abs(motion.velocity).max()),
        top_acceleration=float(np.abs(motion.acceleration).max()),
        gain=gain,
        cad={joint: one for joint, one in found.cad.items() if joint in moved},
        identified={joint: one for joint, one in found.identified.items() if joint in moved},
    )


def read_truth(scenario: Path, poses: Array, scratch: Path) -> dict[str, Array]:
    """True inertia (m,) of every joint at poses (m, n), from the command `sweepid drive truth`."""
    scratch.write_text(json.dumps(poses.tolist()), encoding="utf-8")
    found = json.loads(answer_of_drive("truth", str(scenario), "--poses", str(scratch)))
    scratch.unlink()
    return {joint: np.array(values, dtype=float) for joint, values in found.items()}


ERRORS = (
    "formula of the paper, measured sweeps",
    "sweepid estimate, measured sweeps",
    "CAD model, whole workspace",
    "formula of the paper, whole workspace",
    "sweepid model, whole workspace",
)


def compare(content: Content, axes: Sequence[ReportedAxis], scenario: Path, scratch: Path) -> tuple[TruthRow, ...]:
    """Errors in percent, one column per axis: median and, in brackets, the 95th percentile of their absolute values.

    "sweeps": each measured inertia; "workspace": the resulting models, over all collision-free poses. The
    paper's formula (8) becomes a model by standard least squares, as in the paper.
    """
    sets = [content.workspace, *(axis.poses for axis in axes)]
    true = read_truth(scenario, np.concatenate(sets), scratch)
    parts = np.split(np.arange(sum(map(len, sets))), np.cumsum([len(poses) for poses in sets])[:-1])
    workspace = {joint: values[parts[0]] for joint, values in true.items()}
    in_sweeps = {axis.joint: true[axis.joint][part] for axis, part in zip(axes, parts[1:], strict=True)}
    from_paper = _paper_model(content, axes)
    lines = (
        (ERRORS[0], [(axis.paper, in_sweeps[axis.joint]) for axis in axes]),
        (ERRORS[1], [(axis.measured, in_sweeps[axis.joint]) for axis in axes]),
        (ERRORS[2], [(axis.reference_workspace, workspace[axis.joint]) for axis in axes]),
        (ERRORS[3], [(from_paper[a.joint], workspace[a.joint]) for a in axes]),
        (ERRORS[4], [(a.identified_workspace, workspace[a.joint]) for a in axes]),
    )
    return tuple(TruthRow(label, tuple(error(found, true) for found, true in pairs)) for label, pairs in lines)


def _paper_model(content: Content, axes: Sequence[ReportedAxis]) -> dict[str, Array]:
    """Inertias over the workspace from base parameters fitted to the paper's values by standard least squares."""
    chain = content.robot.chain
    poses = np.array([spec.pose for spec in content.specs])
    moved = [content.robot.index(axis.joint) for axis in axes]
    free = [k for k in range(len(chain.joints)) if k in moved or np.ptp(poses[:, k]) > 0]
    chain = lock(chain, {k: float(poses[0, k]) for k in range(len(chain.joints)) if k not in free})
    own = [free.index(k) for k in moved]
    base = base_parameters(chain, tuple(sorted(own)))
    rows = np.vstack([base.rows(chain, k, axis.poses[:, free]) for k, axis in zip(own, axes, strict=True)])
    parameters = np.linalg.lstsq(rows, np.concatenate([axis.paper for axis in axes]), rcond=None)[0]
    return {
        axis.joint: base.rows(chain, k, content.workspace[:, free]) @ parameters
        for k, axis in zip(own, axes, strict=True)
    }


def error(found: Array, true: Array) -> str:
    error = 100 * np.abs(found / true - 1)
    return f"{np.median(error):.2f} ({np.percentile(error, 95):.2f})"
