"""Mass, centre and inertia of a payload: a motion of all axes without it, the same one with it.

    python payload.py max100-class --by "your name"
    python payload.py max100-class --before 7 --by "your name"
    python payload.py max100-class --before 7 --after 9 --by "your name"

The first command measures without the payload, asks you to mount it, and measures again; whoever mounts it later goes
on with the second one. The third one moves nothing. Exit codes: 0 the mass is known (or: without it is measured), 1 it
is not, or failed, 2 bad input, 3 stopped, 4 no mass detected, or no body can have these values.
"""

import sys
from pathlib import Path

from runbook import CELL_HELP, Exit, Runbook, optional_list, parser_of, run

from service import BadInput, writing
from service.cli.terminal import write_file
from service.model.results.part import with_std
from service.model.results.payload import Payload
from service.web.client import Json, ServiceProblem


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("robot", help="name of a robot that is stored in the service")
    parser.add_argument("--before", type=int, help="campaign without the payload; default: measure it")
    parser.add_argument("--after", type=int, help="campaign with the payload; default: measure it")
    parser.add_argument("--axes", type=optional_list, default=[], help="joints to move, comma separated; default: all")
    parser.add_argument("--cell", help=CELL_HELP)
    parser.add_argument("--trajectories", type=int, default=2, help="how many; two show how well the mass repeats")
    parser.add_argument("--velocity", type=float, default=0.5, help="rad/s (m/s), of each axis")
    parser.add_argument("--move-velocity", type=float, default=0.5, help="rad/s (m/s), on the ways between")
    parser.add_argument("--out", type=Path, default=Path("payload"), help="new folder: payload.json, sheet.md")
    return run("payload", parser, payload)


def payload(book: Runbook) -> Exit:
    given, client = book.given, book.client
    if given.out.exists():
        raise BadInput("--out", f"{given.out} exists already; nothing is overwritten")
    if given.before is None:
        document = book.robot_named(given.robot)
        robot = book.identify_machine(document)
        request = {"kind": "trajectory", "robot_id": document["id"], "cell": book.cell()}
        request |= {"axes": given.axes or list(robot.joints), "trajectories": given.trajectories}
        plan = book.planned(request | {"velocity": given.velocity, "move_velocity": given.move_velocity})
        bound = max(plan["document"]["payload_std"])
        book.step("mass", f"will be known to {bound:.2g} kg (std) at best by each of {given.trajectories} motions")
        before = book.measured(robot, plan)
        if isinstance(before, Exit):
            return before
        if not book.agreed("Mount the payload; nobody may be in the cell when it moves.", "mounted"):
            book.step("with the payload", f"payload.py {given.robot} --before {before['id']}")
            return Exit.DONE
    else:
        before = book.completed(given.before)
        robot = book.identify_machine(client.robot(before["robot_id"]))
    after = book.repeated(robot, before)
    return after if isinstance(after, Exit) else identified(book, before, after)


def identified(book: Runbook, before: Json, after: Json) -> Exit:
    """Print mass, centre and inertia, and write them with the sheet of the controls."""
    out: Path = book.given.out
    with writing(out):
        out.mkdir(parents=True)
    computed = book.client.payload_over(before["id"], after["id"])
    if computed["document"] is None:
        raise BadInput("payload", computed["cause"])
    found = Payload.read(computed["document"], "payload")
    write_file(out / "payload.json", found.to_json())
    parts = {"mass": found.mass} | {f"centre {x}": one for x, one in found.center.items()} | dict(found.inertia)
    units = ["kg", *3 * ["m"], *6 * ["kg m2"]]
    for (name, one), unit in zip(parts.items(), units, strict=True):
        value = " +- ".join(with_std(one.value, one.std)) if one.excited else "not known: not excited"
        book.step(name, f"{value} {unit}" if one.excited else value, figure=one.as_json())
    for sentence in found.sentences:
        book.step("note", sentence)
    try:
        write_file(out / "sheet.md", book.client.payload_sheet(computed["id"]))
    except ServiceProblem as error:
        book.step("sheet", f"none: {error}")
        return Exit.AMBER
    book.step("sheet", f"{out / 'sheet.md'}: what to enter in the control")
    return Exit.DONE


if __name__ == "__main__":
    sys.exit(main())
