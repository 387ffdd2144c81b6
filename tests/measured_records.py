"""Compares records with their references: `python -m tests.measured_records FOLDER`, in this project ../shared/data.

Writes docs/reference/measured-records.md. A record is a file of `KNOWN`, the loop of a control, or any bundle in the
folder; a truth.json beside a bundle has its true inertia and what it hides. References are used to compare, only.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import sweepid
from service.diagnosis.effects import CATALOGUE
from service.formats.sinumerik.document import Given, measurement_document, response_table
from service.formats.sinumerik.measurement import measurement_of
from service.formats.sinumerik.members import read_members
from service.model import Sweep
from service.model.results.diagnosis import AxisDiagnosis
from tests.numeric.simple_estimators import motion

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/reference/measured-records.md"
AT_FLOOR = 1.5  # times the noise floor: most that a complete model leaves
TOP = """# Records with a reference

```console
$ python -m tests.measured_records ../shared/data
```

Measured: `emps`, `sinumerik`. Computed: `everyday`; `foreign`, by a plant that shares no code: its truth is the
reference. J in kg m² (kg) with std (error in %), medians of the sweeps; sweeps with lines are identified with the
effects named. Least squares: J, viscous and Coulomb friction, a constant (loop: 1 + iω J/K). Gap: % of the effort, held
out. `unknown` is right for an effect outside the catalogue.

| record | reference | J | least squares | verdict | gap |
|---|---|---|---|---|---|
"""


class Reference(NamedTuple):
    """Inertia, kg m^2 (kg), of all sweeps or of each; its source; effects, and names that are part of them."""

    inertia: float | list[float] = np.nan
    source: str = ""
    hidden: tuple[str, ...] = ()
    companions: tuple[str, ...] = ()
    mapping: Path | None = None


EMPS, LOOP = "emps/DATA_EMPS.mat", "sinumerik/frequency-response-trace.xml"
TABLE = "everyday/G01_solution_line_trace/trace.xml"
KNOWN = {
    EMPS: Reference(
        95.1089, ", Janot 2019", ("asymmetric_friction",), ("coulomb_friction",), ROOT / "config/traces/emps.yaml"
    ),
    TABLE: Reference(4.0, ", as made", ("coulomb_friction",)),
}


def records(folder: Path) -> list[str]:
    """What is there, relative to the folder."""
    bundles = sorted(str(path.parent.relative_to(folder)) for path in folder.rglob("bundle.json"))
    return [name for name in (*KNOWN, LOOP) if (folder / name).is_file()] + bundles


def lines(folder: Path, name: str) -> list[str]:
    """Of the page: the row of a record and, if anything is wrong, what."""
    cells, wrong = _loop(folder / name) if name == LOOP else _compared(folder / name, KNOWN.get(name))
    return [f"| {name} | {' | '.join(cells)} |", *[f"- {name}: {'; '.join(wrong)}"] * bool(wrong)]


def _compared(path: Path, known: Reference | None) -> tuple[list[str], list[str]]:
    reference = known or _truth(path)
    if path.is_dir():
        bundle = sweepid.read_bundle(path)
    else:
        bundle = sweepid.import_trace(reference.mapping or path, path if reference.mapping else None)
    diagnosis = sweepid.diagnose(bundle, twin=False)
    ((joint, axis),) = diagnosis.axes.items()
    rows = sweepid.identify(bundle, effects=diagnosis).axes[joint].inertia
    sweeps = {sweep.spec.id: sweep for sweep in bundle.sweeps}
    true = dict(zip(sweeps, np.broadcast_to(reference.inertia, len(sweeps)), strict=True))
    right = np.array([true[row.sweep] for row in rows])
    found, std = np.array([(row.value, row.std) for row in rows]).T
    simple = np.array([_least_squares(sweeps[row.sweep]) for row in rows])
    off, simply_off = (100 * np.median(np.abs(one / right - 1)) for one in (found, simple))
    told = axis.candidates or [effect.effect for effect in axis.effects]
    cells = [
        f"{np.median(right):.5g}{reference.source}",
        f"{np.median(found):.5g} ± {np.median(std):.2g} ({off:.2f})",
        f"{np.median(simple):.5g} ({simply_off:.2f})",
        f"{axis.verdict}: {(' or ' if axis.candidates else ', ').join(told)}" if told else axis.verdict,
        f"{axis.gap.before_percent:.2f} to {axis.gap.after_percent:.2f}",
    ]
    wrong = list(_wrong(axis, reference))
    if (beyond := np.mean(np.abs(found - right) > 2 * std)) > 0.05:
        wrong.append(f"{100 * beyond:.0f} % of J beyond two std (by chance 5)")
    return cells, wrong + ["least squares is nearer"] * bool(off > simply_off)


def _truth(bundle: Path) -> Reference:
    path = bundle.parent / "truth.json"
    truth = json.loads(path.read_text("utf-8")).get(bundle.name) if path.is_file() else None
    return Reference(truth["J_true"], "", tuple(truth["hidden"]), tuple(truth["companions"])) if truth else Reference()


def _least_squares(sweep: Sweep) -> float:
    moved = motion([sweep])
    rows = np.hstack([moved.gain, moved.speed, np.sign(moved.speed), np.ones_like(moved.speed)])
    return float(np.linalg.lstsq(rows, moved.effort[:, 0], rcond=None)[0][0])


def _wrong(axis: AxisDiagnosis, reference: Reference) -> Iterator[str]:
    told, real = {effect.effect for effect in axis.effects} | {*axis.candidates}, {*reference.hidden}
    missing = real - told if axis.verdict != "unknown" else (real - told) & {*CATALOGUE}
    yield from (f"{effect} is not named" for effect in sorted(missing))
    if axis.verdict == "named":
        yield from (f"{effect} is not in the reference" for effect in sorted(told - real - {*reference.companions}))
    for effect in axis.effects:
        given = effect.parameters.items()
        if loose := [name for name, one in given if one.std is not None and one.std > 0.5 * abs(one.value)]:
            yield f"{effect.effect}: std above half of {', '.join(loose)}"
    floor = axis.gap.noise_floor_rms
    if axis.gap.after_rms > axis.gap.before_rms:
        yield "the gap grows"
    if floor and axis.gap.after_rms > AT_FLOOR * floor:
        yield f"gap after is {axis.gap.after_rms / floor:.1f} times noise"


def _loop(path: Path) -> tuple[list[str], list[str]]:
    """A closed speed loop: J over the gain alone, and no torque to diagnose."""
    measured = measurement_of(read_members(path))
    fit = measurement_document(measured, Given(), path.name).inertia["time_series"]
    assert fit.over_gain is not None
    table, (low, high) = response_table(measured), fit.band
    used = (table["frequency"] >= low) & (table["frequency"] <= high)
    speed, inverse = 2 * np.pi * table["frequency"][used], 1 / (table["re"] + 1j * table["im"])[used]
    simple = 1e3 * float(speed @ inverse.imag / (speed @ speed))
    found, std = 1e3 * fit.over_gain.value, 1e3 * fit.over_gain.std
    wrong = [f"{abs(found - simple) / std:.1f} std from least squares", f"misfit {fit.misfit_percent:.0f} %"]
    return ["none", f"J/K {found:.3f} ± {std:.2g} ms", f"{simple:.3f}", "no torque", ""], wrong


def main(folder: Path) -> None:
    found = [lines(folder, name) for name in records(folder)]
    wrong = [line for _, *rest in found for line in rest]
    PAGE.write_text(TOP + "\n".join([*(row for row, *_ in found), "", "## What is wrong", "", *wrong, ""]), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
