"""`sweepid plan ROBOT`: let the service choose poses and sweeps, or trajectories that move several axes at once."""

from __future__ import annotations

import json
import math
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal, Self, cast

import typer

from service import BadInput, SweepidError
from service.cli.terminal import (
    DEFAULT_URL,
    CellName,
    ConfirmCell,
    ConfirmRobot,
    RobotFile,
    Url,
    connect,
    waiting,
    write_file,
)

if TYPE_CHECKING:
    from service.web.client import Json, ServiceClient

Criterion = Literal["d_optimal", "condition", "condition_and_travel"]
Modes = Literal["drive_side", "host_streamed", "one_host_streamed"]  # who generates the motion


def plan(
    axes: Annotated[str, typer.Option(help="Joints to measure, separated by commas.")],
    varied: Annotated[str, typer.Option(help="Joints whose positions make the grid of poses, separated by commas.")],
    robot: RobotFile = None,
    poses: Annotated[int | None, typer.Option(min=1, help="Budget: how many poses to choose (usually 24).")] = None,
    duration: Annotated[float | None, typer.Option(help="Budget: s for the whole campaign.")] = None,
    confidence: Annotated[
        float | None, typer.Option(help="Budget: required confidence of J in the whole workspace, percent.")
    ] = None,
    criterion: Annotated[
        Criterion | None, typer.Option(help="Criterion for the choice of the next pose (default: d_optimal).")
    ] = None,
    realisations: Annotated[
        int | None,
        typer.Option(
            min=1, help="Realisations: sweeps of an axis in a pose, with different random phases (default: 1)."
        ),
    ] = None,
    simultaneous: Annotated[
        bool,
        typer.Option(
            "--simultaneous", help="Several axes in one sweep, streamed by the host, where that takes less robot time."
        ),
    ] = False,
    step: Annotated[float | None, typer.Option(help="deg (cm) between grid positions.")] = None,
    cell: CellName = None,
    modes: Annotated[Modes | None, typer.Option(help="Who generates the motion; the last: one sweep an axis.")] = None,
    lines: Annotated[str | None, typer.Option(help="Frequencies of the sines, whole Hz, separated by commas.")] = None,
    sample_rate: Annotated[float | None, typer.Option(help="Hz.")] = None,
    warm_up: Annotated[
        float | None, typer.Option(help="Warm-up: s of sweeps before the first one that is evaluated.")
    ] = None,
    initial_analysis: Annotated[
        bool,
        typer.Option(
            "--initial-analysis", help="Initial analysis: noise runs that identify drive trains and ideal frequencies."
        ),
    ] = False,
    diagnosis: Annotated[
        bool, typer.Option("--diagnosis", help="All kinds of sweeps in a few poses, for a diagnosis.")
    ] = False,
    blocks: Annotated[
        str | None, typer.Option(help="Of a diagnosis: the kinds of sweeps, separated by commas (usually all).")
    ] = None,
    repeats: Annotated[
        int | None, typer.Option(min=1, help="Of a diagnosis or initial analysis, in each pose.")
    ] = None,
    analysis: Annotated[
        int | None, typer.Option(help="Campaign whose initial analysis is used to design the sweeps.")
    ] = None,
    prior_from: Annotated[
        list[int] | None,
        typer.Option(help="Campaign of another robot of the type; four or more are a prior.", metavar="N", min=1),
    ] = None,
    elsewhere: Annotated[
        bool,
        typer.Option(
            "--elsewhere",
            help="For a machine other than that of the service: the plan is not compared with its drives.",
        ),
    ] = False,
    confirm_robot: ConfirmRobot = None,
    confirm_cell: ConfirmCell = None,
    out: Annotated[Path | None, typer.Option(help="Write the plan to this file as well.")] = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Plan a campaign. Nothing moves. Prints the number of the plan, and on stderr what the plan promises."""

    numbers = {"--step": step, "--sample-rate": sample_rate, "--duration": duration, "--confidence": confidence}
    numbers["--warm-up"] = warm_up
    for name, number in numbers.items():
        if number is not None and not math.isfinite(number):
            raise BadInput(name, f"{number} is not a finite number")
    if initial_analysis and diagnosis:
        raise BadInput("--diagnosis", "cannot be combined with --initial-analysis: give one of them")
    options: Json = {
        "poses": poses,
        "duration": duration,
        "confidence": confidence,
        "criterion": criterion,
        "realisations": realisations,
        "simultaneous": simultaneous or None,
        "step": step,
        "cell": cell,
        "modes": modes,
        "lines": None if lines is None else _frequencies(lines),
        "sample_rate": sample_rate,
        "warm_up": warm_up,
        "kind": "analysis" if initial_analysis else "diagnosis" if diagnosis else None,
        "blocks": None if blocks is None else _names(blocks),
        "repeats": repeats,
        "analysis": analysis,
        "prior_from": prior_from or None,
    }
    request: Json = {name: value for name, value in options.items() if value is not None}
    request |= {"axes": _names(axes), "varied": _names(varied)}
    doing = "planning: poses, sweeps and collision-free paths are computed"
    planned = _planned(url, robot, request, doing, elsewhere, confirm_robot, confirm_cell)
    tell_plan(planned["document"], planned["expected_time"])
    if out is not None:
        write_file(out, json.dumps(planned, indent=2))
    sys.stdout.write(f"{planned['id']}\n")


def plan_trajectories(
    axes: Annotated[str, typer.Option(help="Joints to move at once, separated by commas; the others stand at home.")],
    robot: RobotFile = None,
    trajectories: Annotated[int | None, typer.Option(help="How many (usually 3).")] = None,
    period: Annotated[float | None, typer.Option(help="s, of the fundamental (usually 10).")] = None,
    harmonics: Annotated[int | None, typer.Option(help="How many of the fundamental (usually 5).")] = None,
    velocity: Annotated[
        float | None, typer.Option(help="rad/s (m/s): largest sum of the amplitudes of an axis.")
    ] = None,
    acceleration: Annotated[float | None, typer.Option(help="rad/s^2 (m/s^2).")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random trajectories.")] = None,
    sweeps: Annotated[
        int | None, typer.Option(help="Campaign whose sweeps are combined with the trajectories.")
    ] = None,
    cell: CellName = None,
    confirm_robot: ConfirmRobot = None,
    confirm_cell: ConfirmCell = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Plan exciting trajectories. Nothing moves. Prints the number of the plan."""
    options: Json = {
        "trajectories": trajectories,
        "period": period,
        "harmonics": harmonics,
        "velocity": velocity,
        "acceleration": acceleration,
        "seed": seed,
        "sweeps": sweeps,
        "cell": cell,
    }
    request: Json = {name: value for name, value in options.items() if value is not None}
    request |= {"kind": "trajectory", "axes": _names(axes)}
    doing = "planning: trajectories and collision-free paths are computed"
    planned = _planned(url, robot, request, doing, False, confirm_robot, confirm_cell)
    document = planned["document"]
    conditions = ", ".join(f"{condition:.0f}" for condition in document["condition"])
    sys.stderr.write(f"condition numbers {conditions}; {planned['expected_time'] / 60:.0f} min\n")
    # two motions, each with and without, at the bound: 90 % differ by less
    apart = 1.64 * 2**0.5 * max(document["payload_std"])
    sys.stderr.write(
        f"a payload's mass, with and without it: two motions agree within {apart:.2g} kg at best (bound, torque noise "
        "0.5 % of rated); for less, move faster or further, or repeat\n"
    )
    sys.stdout.write(f"{planned['id']}\n")


def _planned(
    url: str,
    robot: Path | None,
    request: Json,
    doing: str,
    elsewhere: bool,
    confirm_robot: str | None,
    confirm_cell: str | None,
) -> Json:
    """The stored plan; its robot, cell and machine are told."""

    names = {"confirm_robot": confirm_robot, "confirm_cell": confirm_cell}
    with connect(url) as client:
        number = robot_number(client, robot)
        with waiting(doing):
            planned = client.add_plan(request | {"robot_id": number}, elsewhere=elsewhere, **names)
    tell_subject(planned)
    return planned


def tell_plan(document: Json, seconds: float) -> None:
    """What a person wants to know of a plan before it is run."""
    for dropped in document["dropped"]:
        sys.stderr.write(f"pose {dropped['pose']} left out: {dropped['reason']}\n")
    if document["request"].get("kind") in ("analysis", "diagnosis"):
        sys.stderr.write(f"{len(document['sweeps'])} runs, {seconds / 60:.0f} min\n")
        return
    from service.model.results.part import two_digits

    confidence, spare = document["confidence"], document["spare"]
    stated = "none is expected everywhere" if confidence[-1] is None else f"expected {two_digits(confidence[-1])} %"
    sys.stderr.write(
        f"{len(confidence)} poses, {len(document['sweeps'])} sweeps, {seconds / 60:.0f} min; "
        f"confidence of J: {stated} in the workspace\n"
    )
    if document["alone"]:
        sys.stderr.write(f"{document['alone']}\n")
    if confidence[-1] is None and document["undetermined"]:
        enough = document["enough_poses"]
        sys.stderr.write(
            "The estimate may leave these base parameters undetermined, and then states no confidence of J: the sweeps "
            f"are not better than CAD for {', '.join(document['undetermined'])}. "
            + (f"Plan {enough} poses (--poses {enough})\n" if enough else "Plan more poses, or vary another joint\n")
        )
    if spare:
        numbers = ", ".join(str(pose["number"]) for pose in spare)
        sys.stderr.write(f"poses that do not improve this, in the order of choice: {numbers}\n")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _frequencies(text: str) -> list[float]:
    try:
        return [float(name) for name in _names(text)]
    except ValueError:
        raise BadInput("--lines", f"{text} is not a list of numbers") from None


def robot_number(client: ServiceClient, side_file: Path | None) -> int:
    """The service's number of the robot of a side file, or of its machine. BadInput if that is not configured."""
    from service.model.configuration import read_robot

    if side_file is not None:
        known = read_robot(side_file)
        return int(client.add_robot(known.description.model_dump(mode="json"), known.urdf_text)["id"])
    machines = client.machines()
    here = next((one for one in machines["items"] if one["here"]), None)
    if here is None or here["robot_id"] is None:
        raise BadInput("ROBOT", f"name its file: {'; '.join(machines['missing']) or 'the service has no machine'}")
    return int(here["robot_id"])


def tell_subject(planned: Json) -> None:
    """Robot, cell and machine of a plan of the service, and which limits its drive profile narrows, to stderr."""
    from service.planning.campaigns.stored_plan import plan_subject

    sys.stderr.write(f"{plan_subject(planned['robot_id'], planned['document']).sentence}\n")
    made_for: Json | None = planned["document"]["made_for"]
    if made_for is not None and made_for["narrowed"]:
        sys.stderr.write(f"narrower limits of the drive profile, which the plan keeps: {made_for['narrowed']}\n")


def measure(
    plan: Annotated[str, typer.Argument(help="Number of a plan, or the file that `sweepid plan --out` wrote.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Run a plan: move, measure, identify. Prints the number of the campaign.

    Ctrl-C, SIGTERM and a terminal that goes away stop the machine.
    """

    sys.stdout.write(f"{run_plan(plan, url)}\n")


class NotCompleted(SweepidError):
    """The campaign holds or was given up before all its sweeps were identified; the message says why."""


def run_plan(plan: str, url: str) -> int:
    """Move, measure, identify; the number of the campaign. A signal that ends the program stops the machine first."""

    with connect(url) as client:
        campaign_id = int(client.add_campaign(plan_number(plan))["id"])
        with TerminationSignals() as signals:
            try:
                client.start(campaign_id, seen=tell_motion(client, campaign_id))
                watch(client, campaign_id, signals)
            except BaseException:  # also what a terminal that is gone made of it
                if not signals.by:
                    raise
                raise _stopped(client, campaign_id, signals.by, url) from None
    return campaign_id


def tell_motion(client: ServiceClient, campaign_id: int) -> Json:
    """Print what the start will move, from where the axes stand; returns the ranges. Connects the drives for it."""
    from service.planning.campaigns.stored_plan import PlanSubject

    if not client.drives()["connected"]:
        client.connect()
    ahead = client.ahead(campaign_id)
    if ahead["refused"]:
        raise NotCompleted(ahead["refused"])
    told = [PlanSubject.model_validate(ahead["subject"]).sentence]
    moves = ", ".join(f"{leg['joint']} to {leg['target']:.4g}" for leg in ahead["approach"])
    told.append(f"approach not known: {ahead['trouble']}" if ahead["trouble"] else f"approach: {moves or 'none'}")
    told += [f"{joint} between {low:.4g} and {high:.4g} rad (m)" for joint, (low, high) in ahead["range"].items()]
    sys.stderr.write("".join(f"{line}\n" for line in told))
    return cast("Json", ahead["range"])


def _stopped(client: ServiceClient, campaign_id: int, why: str, url: str) -> NotCompleted:
    """Stop the machine; the error to report."""
    then = f"release the stop and resume or abort the campaign at {url}"
    try:
        client.stop("sweepid measure", why)
    except SweepidError as error:
        return NotCompleted(f"campaign {campaign_id}: THE STOP IS NOT CONFIRMED: {error}; look at the machine, {then}")
    return NotCompleted(f"campaign {campaign_id}: machine stopped; {then}")


def plan_number(plan: str, largest: int = 2**26) -> int:
    """The number of a plan given as such or as the file of a plan, of at most `largest` bytes."""

    from pydantic import BaseModel

    class NumberedPlan(BaseModel):
        """What `sweepid plan --out` writes; only the number matters here."""

        id: int

    if plan.isascii() and plan.isdigit():
        return int(plan)
    try:
        with Path(plan).open("rb") as file:
            content = file.read(largest + 1)
        if len(content) > largest:
            raise BadInput(plan, f"is larger than {largest} bytes")
        return NumberedPlan.model_validate_json(content).id
    except OSError as error:
        raise BadInput(plan, f"neither the number of a plan nor a readable file: {error.strerror}") from None
    except ValueError:
        raise BadInput(plan, "is not a plan that `sweepid plan --out` wrote") from None


def watch(client: ServiceClient, campaign_id: int, signals: TerminationSignals) -> None:
    """Show the campaign's progress on the terminal until it is completed; NotCompleted if it will not be."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    from service.model.causes import in_words, read

    columns = (
        TextColumn("campaign {task.fields[campaign]}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        bar = bars.add_task("", campaign=campaign_id, total=None)
        # all events from the first on, so none is missed between starting and listening
        for event in client.events(campaign_id):
            signals.check()
            if event["kind"] == "estimate":
                continue
            campaign = client.campaign(campaign_id)
            progress = campaign["progress"]
            bars.update(bar, total=progress["total"], completed=progress["done"], description=_doing(campaign))
            if campaign["state"] == "completed":
                return
            if campaign["state"] in ("paused", "aborted"):
                cause = campaign["structured_cause"]
                why = campaign["cause"] or "by command" if cause is None else in_words(read(cause))
                raise NotCompleted(f"campaign {campaign_id} {campaign['state']}: {why}")


def _doing(campaign: Json) -> str:
    """Remaining time and sweep; which axis moves at this moment changes faster than its events."""
    progress = campaign["progress"]
    current, remaining = progress["current"], progress["remaining"]
    if current is None:
        return "identifying" if campaign["state"] == "measured" else campaign["state"]
    left = "" if remaining is None else f"{int(remaining // 60)}:{int(remaining % 60):02d} left, "
    return f"{left}sweep {current['number']} of {current['spec']['axis']}, with the path to its pose"


_SIGNALS = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "the terminal was lost"}
_Handler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None  # as `signal.signal` has it


class TerminationSignals:
    """While the block runs, the first signal that ends a program raises KeyboardInterrupt; those after it wait.

    `by` says which it was. What the caller of the program has set to be ignored (nohup) stays ignored. Python drops an
    exception that is raised while a finalizer runs: `check` raises it again.
    """

    def __init__(self) -> None:
        self.by = ""
        self._before: dict[signal.Signals, _Handler] = {}

    def __enter__(self) -> Self:
        for name in _SIGNALS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._tell)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _tell(self, number: int, _: FrameType | None) -> None:
        if not self.by:
            self.by = _SIGNALS[signal.Signals(number).name]
            self.check()

    def check(self) -> None:
        """KeyboardInterrupt if a signal has come."""
        if self.by:
            raise KeyboardInterrupt
