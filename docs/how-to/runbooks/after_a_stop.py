"""After a stop, a crash or a power failure: state of machine and campaign, and the required steps, one by one.

    python after_a_stop.py --by "your name"

Each step states what it moves and is executed only after you type its word. Exit codes: 0 no step is left,
1 a step failed or the campaign paused again, 2 bad input, 3 a step was declined or the machine stopped, 4 a resumed
campaign with a required confidence used its sweeps up without reaching it.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from reached import confidence
from runbook import Exit, Runbook, ending, parser_of, run

from service import BadInput
from service.web.client import Json

NOTHING = "moves nothing"


@dataclass(frozen=True)
class Step:
    """One step. `word`: what the person types; `do`: executes it."""

    what: str
    word: str
    moves: str
    do: Callable[[], object]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--campaign", type=int, help="campaign to resume; default: the newest that is paused")
    return run("after_a_stop", parser, after_a_stop)


def after_a_stop(book: Runbook) -> Exit:
    client = book.client
    campaign = paused(book)
    if campaign is not None:
        book.identify_machine(client.robot(campaign["robot_id"]))
    tell(book, campaign)
    if book.given.dry_run:
        for step in due(book):
            book.step("to do", f"{step.what}; {step.moves}")
        if campaign is not None:
            tell_resume(book, campaign)
        return Exit.DONE
    done: set[str] = set()
    while steps := due(book):
        step = steps[0]
        if step.what in done:
            book.step(step.what, "did not help: check the machine, see docs/how-to/when-it-stops.md")
            return Exit.FAILED
        if not confirmed(book, step):
            return Exit.STOPPED
        step.do()
        book.step(step.what, "done")
        done.add(step.what)
    return Exit.DONE if campaign is None else resumed(book, campaign)


def paused(book: Runbook) -> Json | None:
    """The campaign to continue; None: there is none. BadInput while a campaign uses the machine."""
    every = book.client.campaigns()
    busy = next((one for one in every if one["state"] in ("running", "pausing")), None)
    if busy is not None:
        raise BadInput(
            "campaign", f"campaign {busy['id']} is {busy['state']}: wait until it ends, or stop the machine first"
        )
    wanted = book.given.campaign
    found = [one for one in every if one["state"] == "paused" and wanted in (None, one["id"])]
    if wanted is not None and not found:
        raise BadInput("campaign", f"campaign {wanted} is not paused")
    return found[-1] if found else None


def tell(book: Runbook, campaign: Json | None) -> None:
    """Print the state of machine and campaign."""
    drives, ready = book.client.drives(), book.client.ready()
    book.step("machine", "connected" if drives["connected"] else f"not connected: {drives['trouble']}")
    for axis in drives["axes"]:
        book.step(axis["joint"], ", ".join(part for part in (axis["state"], fault_of(axis)) if part))
    for cause in ready["causes"]:
        book.step("not ready", cause)
    for stop in book.client.stops():
        book.step(f"stop {stop['id']}", f"latched by {stop['by']} at {stop['at']}: {stop['why']}", stop=stop)
    if campaign is None:
        book.step("campaign", "none is paused")
    else:
        counts = ", ".join(f"{count} {state}" for state, count in campaign["sweeps"].items())
        book.step(f"campaign {campaign['id']}", f"{ending(campaign)} ({counts})", campaign=campaign["id"])


def fault_of(axis: Json) -> str:
    """The fault of an axis as text; an emergency stop by its name, because the drive shows only a code."""
    fault = axis["fault"]
    if fault is None:
        return ""
    return f"{'EMERGENCY STOP, ' if fault['emergency_stop'] else ''}{fault['text']} ({fault['code']:04X}h)"


def due(book: Runbook) -> list[Step]:
    """The steps before motion, in the required order: each stop, drives, the fault of each axis."""
    client, by = book.client, book.given.by
    steps = [
        Step(
            f"release stop {stop['id']} of {stop['by']} ({stop['why']})",
            "release",
            NOTHING,
            partial(client.reset_stop, by, [stop["id"]]),
        )
        for stop in client.stops()
    ]
    drives = client.drives()
    if not drives["connected"]:
        then = f"{NOTHING}; the axes are disabled afterwards"
        steps.append(Step("connect the drives", "connect", then, client.connect))
    for axis in drives["axes"]:
        if axis["fault"] is not None:
            emergency = "EMERGENCY STOP: release it at the machine first; " if axis["fault"]["emergency_stop"] else ""
            what = f"acknowledge {axis['joint']} ({emergency}{axis['fault']['text']})"
            steps.append(Step(what, "acknowledge", NOTHING, partial(client.acknowledge, axis["joint"])))
    return steps


def confirmed(book: Runbook, step: Step) -> bool:
    book.step("next", f"{step.what}; {step.moves}")
    if book.agreed("Did you check the machine?", step.word):
        return True
    book.step(step.what, "declined")
    return False


def left(book: Runbook, campaign: Json) -> list[Json]:
    """The sweeps of the plan that a resume runs."""
    sweeps = book.client.plan(campaign["plan_id"])["document"]["sweeps"]
    states = {sweep["number"]: sweep["state"] for sweep in book.client.sweeps(campaign["id"])}
    again = ("planned", "failed", "interrupted")
    return [sweep for number, sweep in enumerate(sweeps, 1) if states[number] in again]


def resumed(book: Runbook, campaign: Json) -> Exit:
    """The last step: resume the campaign, and repeat its failed and interrupted sweeps."""
    client, number = book.client, campaign["id"]
    seen = tell_resume(book, campaign)
    step = Step(f"resume campaign {number}", "resume", "moves as printed above", lambda: None)
    if not confirmed(book, step):
        return Exit.STOPPED
    campaign = book.watched(number, lambda: client.resume(number, repeat=True, seen=seen))
    if campaign["state"] != "completed":
        return book.not_completed(campaign)
    request = client.plan(campaign["plan_id"])["document"]["request"]
    wanted = request.get("confidence")
    return Exit.DONE if wanted is None else confidence(book, campaign, request["axes"], wanted)


def tell_resume(book: Runbook, campaign: Json) -> Json | None:
    """Print what a resume moves. Returns the ranges of the axes; None if no sweep is left."""
    sweeps = left(book, campaign)
    book.step(f"resume of campaign {campaign['id']}", f"{len(sweeps)} sweeps left; these axes move")
    if sweeps:
        book.tell_moves(book.identify_machine(book.client.robot(campaign["robot_id"])), sweeps)
        return book.tell_ahead(book.client.ahead(campaign["id"], repeat=True))
    return None


if __name__ == "__main__":
    sys.exit(main())
