"""How cost grows: s of the processor against sweeps, poses, axes and samples, with the exponent of a fitted power."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from service.estimation import estimate_document
from service.identification.design.pose_selection import Criterion, select_poses
from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import lock
from service.identification.spectra.frequency_response import spectrum
from service.planning.observability import observe
from service.recording import Recording, Sweep
from simulator import run_sweeps
from tests.benchmarks.bench.measured import Measured, timed
from tests.benchmarks.bench.plant import random_poses
from tests.benchmarks.bench.revisions import campaign, spectra
from tests.benchmarks.bench.selection import REQUEST
from tests.numeric.campaign import max100, planned_at, scenario_named

REPEATS = 2


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """n of cost ~ size^n, by least squares of the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def grown(name: str, sizes: Sequence[int], work: Callable[[int], object]) -> Measured:
    """The largest size's cost; the note has all of them."""
    seconds = [min(timed(lambda n=n: work(n))[0] for _ in range(REPEATS)) for n in sizes]
    told = ", ".join(f"{n}: {s * 1e3:.3g} ms" for n, s in zip(sizes, seconds, strict=True))
    return Measured(
        name=name, unit="exponent", ours=exponent(sizes, seconds), repeats=REPEATS, note=told
    )  # fmt: skip


def run() -> Iterator[Measured]:
    robot, told = max100(), spectra()
    estimate_document(robot, told[:24])
    yield grown("estimate, by number of sweeps", (30, 90, 300, 900), lambda n: estimate_document(robot, told[:n]))
    rows = observe(robot, REQUEST, np.zeros(6)).rows(random_poses(8000))
    yield grown(
        "selection of 100 poses, by number of candidates", (1000, 2000, 4000, 8000),
        lambda n: select_poses(rows[:n], 100, Criterion.CONDITION),
    )  # fmt: skip
    yield grown(
        "selection out of 4,000, by number of selected poses", (50, 100, 200, 400),
        lambda n: select_poses(rows[:4000], n, Criterion.CONDITION),
    )  # fmt: skip
    chains = {n: lock(robot.chain, dict.fromkeys(range(n, 6), 0.0)) for n in range(2, 7)}
    yield grown(
        "base parameters, by number of axes", tuple(chains), lambda n: base_parameters(chains[n], tuple(range(n)))
    )
    rng = np.random.default_rng(1)
    poses = {n: np.pad(rng.uniform(-1.0, 1.0, (4000, n - 1)), ((0, 0), (1, 0))) for n in chains}

    def choose(axes: int) -> object:
        base = base_parameters(chains[axes], tuple(range(axes)))
        own = np.stack([base.rows(chains[axes], axis, poses[axes]) for axis in range(axes)], axis=1)
        return select_poses(own, 100, Criterion.CONDITION)

    yield grown("rows and selection of 100 of 4,000 poses, by number of axes", tuple(chains), choose)
    first = campaign().sweeps[0]
    longer = {1000 * k: _longer(first, k) for k in (4, 8, 16, 32)}
    yield grown(
        "spectra of 20 sweeps, by number of samples", tuple(len(one.recording.time) for one in longer.values()),
        lambda n: [spectrum(robot, next(s for s in longer.values() if len(s.recording.time) == n)) for _ in range(20)],
    )  # fmt: skip
    scenario = scenario_named("max100-full")
    _, sweeps = planned_at(scenario, random_poses(100))
    yield grown(
        "virtual plant, by number of sweeps together", (3, 30, 300), lambda n: run_sweeps(scenario, sweeps[:n], 0)
    )


def _longer(sweep: Sweep, times: int) -> Sweep:
    """The sweep with a window `times` as long: its own repeated."""
    spec, record = sweep.spec, sweep.recording
    assert spec.period is not None
    assert spec.periods is not None
    first, count = (round(x * spec.sample_rate) for x in (spec.measure_from, spec.period * spec.periods))
    index = np.concatenate([np.arange(first), first + np.arange(times * count) % count, [first + count - 1] * 10])
    columns = {name: getattr(record, name)[index] for name in ("effort", "velocity", "position")}
    long = Recording(time=np.arange(len(index)) / spec.sample_rate, **columns)
    return Sweep(spec.model_copy(update={"periods": spec.periods * times}), long)
