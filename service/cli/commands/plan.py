"""`sweepid plan ROBOT`: let the service choose poses and sweeps, or trajectories that move several axes at once."""

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from service.cli.options import DEFAULT_URL, CellName, ConfirmCell, ConfirmRobot, RobotFile, Url
from service.model.errors import BadInput

if TYPE_CHECKING:
    from service.web.client import Json


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
    from service.cli.campaign.planned import robot_number, tell_subject
    from service.cli.progress_indicator import waiting
    from service.web.client import ServiceClient

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
    }
    request: Json = {name: value for name, value in options.items() if value is not None}
    request |= {"axes": _names(axes), "varied": _names(varied)}
    with ServiceClient(url) as client:
        number = robot_number(client, robot)
        with waiting("planning: poses, sweeps and collision-free paths are computed"):
            planned = client.add_plan(
                request | {"robot_id": number},
                elsewhere=elsewhere,
                confirm_robot=confirm_robot,
                confirm_cell=confirm_cell,
            )
    tell_subject(planned)
    _tell(planned["document"], planned["expected_time"])
    if out is not None:
        _write(out, planned)
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
    from service.cli.campaign.planned import robot_number, tell_subject
    from service.cli.progress_indicator import waiting
    from service.web.client import ServiceClient

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
    request |= {"kind": "trajectory", "axes": [name.strip() for name in axes.split(",") if name.strip()]}
    with ServiceClient(url) as client:
        number = robot_number(client, robot)
        with waiting("planning: trajectories and collision-free paths are computed"):
            planned = client.add_plan(
                request | {"robot_id": number}, confirm_robot=confirm_robot, confirm_cell=confirm_cell
            )
    tell_subject(planned)
    document = planned["document"]
    conditions = ", ".join(f"{condition:.0f}" for condition in document["condition"])
    sys.stderr.write(f"condition numbers {conditions}; {planned['expected_time'] / 60:.0f} min\n")
    sys.stdout.write(f"{planned['id']}\n")


def _tell(document: "Json", seconds: float) -> None:
    """What a person wants to know of a plan before it is run."""
    for dropped in document["dropped"]:
        sys.stderr.write(f"pose {dropped['pose']} left out: {dropped['reason']}\n")
    if document["request"].get("kind") in ("analysis", "diagnosis"):
        sys.stderr.write(f"{len(document['sweeps'])} runs, {seconds / 60:.0f} min\n")
        return
    confidence, spare = document["confidence"], document["spare"]
    known = "may not be known" if confidence[-1] is None else f"should be known to {confidence[-1]:.2g} % or better"
    sys.stderr.write(
        f"{len(confidence)} poses, {len(document['sweeps'])} sweeps, {seconds / 60:.0f} min; "
        f"J {known} everywhere in the workspace\n"
    )
    if document["undetermined"]:
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


def _write(path: Path, document: "Json") -> None:
    try:
        path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(str(path), f"cannot be written: {error.strerror}") from None
