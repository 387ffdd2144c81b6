"""sweepid in a notebook: identify a robot's inertia from recordings, and find what its model lacks.

Each function takes a bundle, or the folder of one, and returns a result that prints as a table, gives its columns as
arrays (``estimate["std"]``) and as a frame (`to_pandas`), and writes the JSON of the commands (`to_json`). The commands
call the same functions. All numbers are SI, on the joint side. A function imports what it uses when it is called.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from service import BadInput, writing

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from service.formats.export.model import IdentifiedModel
    from service.identification.axis.nominal_priors import TorqueGain
    from service.model import Robot
    from service.model.configuration import Cell
    from service.model.results.combination import Combination
    from service.model.results.diagnosis import DataCheck, Diagnosis
    from service.model.results.estimate import Estimate
    from service.model.results.payload import Payload
    from service.planning.documents import PlanDocument
    from service.store.files.bundle import Bundle
    from service.web.client import ServiceClient as Client

__all__ = [
    "Client",
    "check",
    "combine",
    "diagnose",
    "export",
    "identify",
    "import_trace",
    "payload",
    "plan",
    "read_bundle",
    "read_robot",
]

Item = TypeVar("Item")


class ProgressBar(Protocol):
    """What shows how many of the items are done, as ``lambda items, what: tqdm(items, desc=what)``."""

    def __call__(self, items: Sequence[Item], of_what: str, /) -> Iterable[Item]: ...


def _silent(items: Sequence[Item], of_what: str, /) -> Iterable[Item]:
    return items


def __getattr__(name: str) -> Any:
    if name != "Client":
        raise AttributeError(f"module 'sweepid' has no attribute {name!r}")
    from service.web.client import ServiceClient

    return ServiceClient


def read_robot(path: str | Path) -> Robot:
    """Read a robot from its side file.

    Parameters
    ----------
    path
        Side file (YAML); the URDF that it names is relative to it.

    Returns
    -------
    Robot
        Joints with their limits and drives, and the nominal parameters of the links.

    Raises
    ------
    BadInput
        The file, field and reason.

    Examples
    --------
    >>> import sweepid
    >>> robot = sweepid.read_robot("config/robots/max100-class.yaml")
    >>> robot.joints[:2]
    ('joint_1', 'joint_2')
    """
    from service.model import configuration

    return configuration.read_robot(Path(path))


def read_bundle(folder: str | Path) -> Bundle:
    """Read and validate a bundle: a robot and its measured sweeps.

    Parameters
    ----------
    folder
        Folder with ``bundle.json`` (docs/reference/bundle.md).

    Returns
    -------
    Bundle
        The robot and the sweeps, each with its set-points and its recording as arrays.

    Raises
    ------
    BadInput
        File, sweep and reason of the first error.

    Examples
    --------
    >>> import sweepid
    >>> bundle = sweepid.read_bundle("bundle")
    >>> len(bundle.sweeps), bundle.sweeps[0].recording.effort.shape
    (4, (2500,))
    """
    from service.store.files import bundle

    return bundle.read_bundle(Path(folder))


def import_trace(
    mapping: str | Path, source: str | Path | None = None, out: str | Path | None = None, **known: Any
) -> Bundle:
    """Turn a trace of a control, drive, robot or logger into a bundle.

    Parameters
    ----------
    mapping
        Trace file, recognised by its content; or a mapping file (YAML) of columns, units and sweeps
        (docs/how-to/your-own-trace.md).
    source
        Trace file in place of the one that the mapping names.
    out
        Folder to write the bundle to; must be empty or not exist. None: it is not written.
    **known
        Of a trace without mapping what its file cannot know: ``axis``, ``kind``, ``gear_ratio``, ``rated_effort``,
        ``torque_constant``, ``inertia``, ``sample_rate``. ``tell`` is called with each guess, as `print`.

    Returns
    -------
    Bundle
        The robot and the sweeps.

    Raises
    ------
    BadInput
        File, column and reason.
    """
    from service.formats.traces.trace_import import mapping_of, read_traces
    from service.store.files.bundle import Bundle, write_bundle

    path, tell = Path(mapping), known.pop("tell", None)
    made = read_traces(mapping_of(path, **known), path, None if source is None else Path(source))
    if tell is not None:
        for note in made.notes:
            tell(note)
    if out is not None:
        with writing(out):
            write_bundle(Path(out), made.robot, made.sweeps)
    return Bundle(made.robot, made.sweeps, str(mapping))


def check(bundle: Bundle | str | Path) -> DataCheck:
    """Find what is wrong with recordings and robot file, before any physics is fitted.

    Parameters
    ----------
    bundle
        A bundle, or the folder of one.

    Returns
    -------
    DataCheck
        The findings; one that is ``wrong`` forbids to trust its axis.

    Examples
    --------
    >>> import sweepid
    >>> sweepid.check("bundle")
    Nothing found in 4 sweeps.
    """
    from service.data_check import check as check_data, findings_document

    measured = _read(bundle)
    findings = check_data(measured.robot, measured.sweeps)
    return findings_document(measured.robot, measured.sweeps, findings)


def identify(
    bundle: Bundle | str | Path,
    axis: str | None = None,
    *,
    torque_gain: Mapping[str, TorqueGain] | str | Path | None = None,
    effects: Diagnosis | str | Path | None = None,
    prior_from: Sequence[str | Path] = (),
    progress: ProgressBar = _silent,
) -> Estimate:
    """Identify a robot: inertia about each axis in each pose, base parameters, and their standard deviations.

    Parameters
    ----------
    bundle
        A bundle, or the folder of one.
    axis
        Use the sweeps of this joint only.
    torque_gain
        Reported torque over true torque by joint, or the file of ``sweepid estimate torque-gain --json``.
    effects
        Known effects of the axes: a diagnosis, or the file of ``sweepid diagnose --model``.
    prior_from
        Files of ``sweepid identify --json`` of at least four other robots of the type: their prior.
    progress
        Called with the sweeps, to show how many are done.

    Returns
    -------
    Estimate
        kg, kg m, kg m^2 (N s/m and kg for prismatic axes). ``std`` is conditional on the torque gain, ``std_total``
        includes its prior.

    Raises
    ------
    BadInput
        The bundle has no sweep that shows an inertia, or a file cannot be used.

    Examples
    --------
    >>> import sweepid
    >>> estimate = sweepid.identify("bundle")
    >>> print(estimate.axes["j1"]["measured"].round(2))
    [7. 7. 7. 7.]
    >>> estimate.axes["j1"].rmse_percent.identified_measured < 0.1
    True
    """
    from service.identification.estimation import estimate_document, sweep_spectrum
    from service.identification.motion.free_motion import at_once, free_motions
    from service.identification.motion.trajectory_record import runs_at_once
    from service.identification.spectra.noise_response import has_reference
    from sweepid.files import effects_of, gains_of, type_of

    measured = _read(bundle)
    robot = measured.robot
    gains, known = gains_of(torque_gain), effects_of(effects, robot)
    if axis is not None:
        robot.index(axis)
    together = {spec.id for group in at_once([sweep.spec for sweep in measured.sweeps]) for spec in group}
    motions = free_motions(robot, measured.sweeps) if axis is None else ()
    sweeps = [
        sweep
        for sweep in measured.sweeps
        if sweep.spec.id not in together
        # a trajectory of several axes is of none of them alone
        and (axis is None or (sweep.spec.axis == axis and not runs_at_once(sweep.spec)))
        and (sweep.spec.shows_inertia or sweep.spec.stepped or has_reference(sweep))
    ]
    if not sweeps and not motions:
        of_joint = "" if axis is None else f" of joint {axis}"
        raise BadInput(measured.place, f"has no sweep{of_joint} with sines, a trajectory or injected torque noise")
    spectra = [sweep_spectrum(robot, sweep) for sweep in progress(sweeps, "Sweeps")]
    earlier = type_of(prior_from, robot)
    return estimate_document(robot, spectra, gains=gains, known=known, motions=motions, earlier=earlier)


def combine(*bundles: Bundle | str | Path) -> Combination:
    """Identify from sweeps of single axes, trajectories and free motions of several axes together.

    Parameters
    ----------
    *bundles
        Bundles of one robot, or their folders.

    Returns
    -------
    Combination
        Every base parameter of the whole dynamics, and what determines it.

    Raises
    ------
    BadInput
        The bundles are of different robots, or have no motion of several axes.
    """
    from service.model import Sweep
    from service.store.files.bundle import Bundle

    read = [_read(bundle) for bundle in bundles]
    for other in read[1:]:
        _same_robot(read[0], other)
    sweeps = [
        Sweep(sweep.spec.model_copy(update={"id": f"{number}-{sweep.spec.id}"}), sweep.recording)
        for number, bundle in enumerate(read, 1)
        for sweep in bundle.sweeps
    ]
    place = ", ".join(bundle.place for bundle in read)
    found = identify(Bundle(read[0].robot, tuple(sweeps), place)).combination
    if found is None:
        raise BadInput(place, "has no trajectory and no free motion of several axes")
    return found


def diagnose(
    bundle: Bundle | str | Path,
    axis: str | None = None,
    *,
    known: Sequence[str] = (),
    start: Estimate | str | Path | None = None,
    twin: bool = True,
    progress: ProgressBar = _silent,
) -> Diagnosis:
    """Find where model and measurement disagree, and name the missing effect.

    Parameters
    ----------
    bundle
        A bundle, or the folder of one.
    axis
        Diagnose this joint only.
    known
        Names of effects that the axes are known to have.
    start
        Estimate (or the file of ``sweepid identify --json``) from which the rigid model starts, instead of CAD; of
        other sweeps than these.
    twin
        Run the simulator with the model found, for the remaining gap.
    progress
        Called with the joints, to show how many are done.

    Returns
    -------
    Diagnosis
        By axis the verdict, the effects, the gap on held-out sweeps, and what to measure next.

    Raises
    ------
    BadInput
        No sweep moves an axis, or the estimate is of another robot.
    """
    from service.diagnosis import as_document, diagnose_axis, is_evidence
    from service.identification.motion.free_motion import at_once
    from sweepid.files import started

    measured = _read(bundle)
    robot = measured.robot if start is None else started(measured.robot, start)
    if axis is not None:
        measured.robot.index(axis)
    together = {spec.id for group in at_once([sweep.spec for sweep in measured.sweeps]) for spec in group}
    alone = [sweep.spec for sweep in measured.sweeps if sweep.spec.id not in together]
    swept = {spec.axis for spec in alone if is_evidence(spec)}
    joints = [joint for joint in measured.robot.joints if joint in swept and axis in (None, joint)]
    if not joints:
        moved = "an axis alone" if axis is None else f"joint {axis} alone"
        raise BadInput(measured.place, f"has no sweep that moves {moved}: measure it (`sweepid plan --diagnosis`)")
    found = [
        diagnose_axis(robot, joint, measured.sweeps, known={name: {} for name in known}, twin=twin)
        for joint in progress(joints, "Axes")
    ]
    return as_document(measured.robot, found)


def payload(
    before: Bundle | str | Path,
    after: Bundle | str | Path,
    *,
    torque_gain: Mapping[str, TorqueGain] | str | Path | None = None,
) -> Payload:
    """Identify a body on the last link from the same motions without and with it.

    Parameters
    ----------
    before, after
        Bundles (or their folders) of the same motions without and with the payload.
    torque_gain
        Reported torque over true torque by joint, or the file of ``sweepid estimate torque-gain --json``.

    Returns
    -------
    Payload
        Mass, kg, centre of mass, m, and inertia about it, kg m^2, in the frame of the last joint.

    Raises
    ------
    BadInput
        The bundles are of different robots or have no motion in common.
    """
    from service.identification import payloads
    from service.identification.payloads import payload_document
    from sweepid.files import gains_of

    first, second = _read(before), _read(after)
    _same_robot(first, second)
    found = payloads.payload(first.robot, first.sweeps, second.sweeps, gains_of(torque_gain))
    return payload_document(first.robot, found)


def plan(
    robot: Robot,
    cell: Cell | str | Path,
    *,
    axes: Sequence[str],
    varied: Sequence[str],
    prior_from: Sequence[str | Path] = (),
    **request: Any,
) -> PlanDocument:
    """Choose poses and design sweeps. Nothing moves; a service plans what it measures itself (`Client.add_plan`).

    Parameters
    ----------
    robot
        The robot.
    cell
        What is around it, or its file.
    axes
        Joints to measure.
    varied
        Joints whose positions make the grid of poses.
    prior_from
        As in `identify`: with a ``confidence`` as the budget, less is left to measure.
    **request
        Other fields of a plan's request (docs/reference/plan.md), as ``poses``, ``confidence`` or ``step``.

    Returns
    -------
    PlanDocument
        The sweeps in their order, with the promised confidence of the inertia.

    Raises
    ------
    BadInput
        Field and reason.

    Examples
    --------
    >>> import sweepid
    >>> robot = sweepid.read_robot("config/robots/max100-class.yaml")
    >>> cell = "config/cells/workshop.yaml"
    >>> planned = sweepid.plan(robot, cell, axes=["joint_1"], varied=["joint_2"], poses=3, step=20)
    >>> [sweep.spec.axis for sweep in planned.sweeps]
    ['joint_1', 'joint_1', 'joint_1']
    """
    from pydantic import ValidationError

    from service.model.configuration import Cell, bad_field, read_cell
    from service.planning.plan import PlanRequest, build_plan
    from sweepid.files import type_of

    around = cell if isinstance(cell, Cell) else read_cell(Path(cell))
    try:
        # the number of the robot is one of a service's store, and there is none
        wanted = PlanRequest.model_validate({"robot_id": 1, "axes": axes, "varied": varied, **request})
    except ValidationError as error:
        raise bad_field("plan", error) from None
    return build_plan(robot, wanted, around, earlier=type_of(prior_from, robot))


def export(robot: Robot, estimate: Estimate, folder: str | Path, *, place: str = "estimate") -> IdentifiedModel:
    """Write the identified robot as URDF, MJCF (MuJoCo) and YAML.

    Parameters
    ----------
    robot
        The robot of the estimate.
    estimate
        What was identified of it.
    folder
        Folder to write; must be empty or not exist.
    place
        What errors call the estimate.

    Returns
    -------
    IdentifiedModel
        Mass, centre of mass and inertia of each body, the motors' inertias and the friction of the axes.

    Raises
    ------
    BadInput
        The estimate is of another robot, or the folder is not empty.

    Examples
    --------
    >>> import sweepid
    >>> bundle = sweepid.read_bundle("bundle")
    >>> model = sweepid.export(bundle.robot, sweepid.identify(bundle), "model")
    >>> [body.link for body in model.bodies]
    ['one', 'two']
    """
    from service.formats.export import model_of, write_model

    model = model_of(robot, estimate, place)
    write_model(Path(folder), model)
    return model


def _read(bundle: Bundle | str | Path) -> Bundle:
    return read_bundle(bundle) if isinstance(bundle, str | Path) else bundle


def _same_robot(first: Bundle, other: Bundle) -> None:
    if (first.robot.description, first.robot.urdf_text) != (other.robot.description, other.robot.urdf_text):
        raise BadInput(
            other.place, f"is not of robot {first.robot.name} of the first bundle: robot file or URDF differs"
        )
