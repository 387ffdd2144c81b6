"""From the trace of another control to an inertia: import by a mapping file, check, identify. Nothing moves.

    python from_a_trace.py mapping.yaml --source trace.csv --out bundle --by "your name"

Exit codes: 0 identified without findings, 1 the data is wrong or gives no inertia, 2 bad input, 3 ended
by a person, 4 identified, with warnings.
"""

import sys
from pathlib import Path

from inertias import inertia_unit
from runbook import Exit, Runbook, parser_of, run

import sweepid
from service import BadInput
from service.cli.terminal import write_file
from service.data_check import check, findings_document
from service.formats.traces.trace_import import import_trace
from service.store.files.bundle import write_bundle


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("mapping", type=Path, help="mapping file of the columns of the trace (YAML)")
    parser.add_argument("--source", type=Path, help="trace file that replaces the one in the mapping")
    parser.add_argument("--out", type=Path, required=True, help="folder of the new bundle; must not exist")
    return run("from_a_trace", parser, from_a_trace)


def from_a_trace(book: Runbook) -> Exit:
    given = book.given
    if given.out.exists():
        raise BadInput("--out", f"{given.out} exists already; nothing is overwritten")
    robot, sweeps = import_trace(given.mapping, given.source)
    book.protocol["robot"] = {"id": None, "name": robot.name}
    axes = sorted({sweep.spec.axis for sweep in sweeps})
    book.step("trace", f"{len(sweeps)} sweeps of {', '.join(axes)} of {robot.name}")
    found = book.findings([one.as_json() for one in findings_document(robot, sweeps, check(robot, sweeps)).findings])
    if given.dry_run:
        book.step("bundle", f"would be written to {given.out}; moves nothing")
        return Exit.DONE
    write_bundle(given.out, robot, sweeps)
    book.step("bundle", f"{given.out}")
    document = sweepid.identify(given.out)
    estimate = given.out.with_name(f"{given.out.name}-estimate.json")
    write_file(estimate, document.to_json())
    for joint in axes:
        inertia = document.axes[joint].inertia if joint in document.axes else ()
        for sweep in inertia:
            value = f"{sweep.value:.5g} +- {sweep.std:.2g} {inertia_unit(robot, joint)}"
            book.step(f"{joint}, sweep {sweep.sweep}", value, inertia=sweep.as_json())
        if not inertia:
            book.step(joint, "its sweeps show no inertia")
            found = Exit.FAILED
    book.step("estimate", f"{estimate}")
    return found


if __name__ == "__main__":
    sys.exit(main())
