"""Common parts of the runbooks: arguments, steps with a line and a protocol entry, monitored campaigns, the stop.

The protocol is a JSON file that is complete after every step, so it also documents an interrupted run. If a run ends
while the machine may move (Ctrl-C, SIGTERM, a lost terminal, a closed output, a failure of this program or of the
network), the machine is stopped first.
"""

import json
import os
import platform
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from enum import IntEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any

from moves import Move, moves, robot_of

from service import BadInput, SweepidError
from service.cli.commands.campaigns import TerminationSignals
from service.model import Robot
from service.planning.campaigns.stored_plan import PlanSubject
from service.web.client import HOST_WATCH, Json, ServiceClient

OVER = ("completed", "paused", "aborted")
TOLD = ("recorded", "failed", "interrupted")  # states of a sweep that make a step
BY_REQUEST = "paused by request"  # cause of a pause that a person requested, as the service gives it
AMBER, RED = 2.0, 4.0  # standard deviations
CELL_HELP = "cell in which the robot stands; default: that of the machine"


class Exit(IntEnum):
    """Exit code for the shell."""

    DONE = 0
    FAILED = 1
    BAD_INPUT = 2
    STOPPED = 3
    AMBER = 4


OUTCOME = {
    Exit.DONE: "done",
    Exit.FAILED: "not passed (exit code 1), see the lines above",
    Exit.STOPPED: "stopped by a person",
    Exit.AMBER: "not decided, or with warnings (exit code 4), see the lines above",
}


def judged(significance: float) -> Exit:
    """Verdict on a deviation in standard deviations: done (green) up to 2, amber up to 4, failed (red) above."""
    size = abs(significance)
    return Exit.DONE if size <= AMBER else Exit.AMBER if size <= RED else Exit.FAILED


def worst(codes: Sequence[Exit]) -> Exit:
    """The worst code: red before amber before green."""
    return next((code for code in (Exit.FAILED, Exit.AMBER) if code in codes), Exit.DONE)


def parser_of(text: str) -> ArgumentParser:
    """The common arguments of all runbooks."""
    parser = ArgumentParser(description=text.partition("\n")[0])
    parser.add_argument("--by", required=True, help="your name, for the protocol")
    parser.add_argument("--url", default=os.environ.get("SWEEPID_URL", "http://127.0.0.1:8642"))
    parser.add_argument("--protocol", type=Path, help="file to write; default: name and time, here")
    parser.add_argument("--dry-run", action="store_true", help="print what would move, and move nothing")
    parser.add_argument("--yes", action="store_true", help="answer every question with yes: only for virtual machines")
    for what in ("robot", "cell"):
        parser.add_argument(f"--confirm-{what}", help=f"type the name of the {what}, if it is not the machine's")
    return parser


class Runbook:
    """One run: its steps, its protocol and the campaign that it monitors."""

    def __init__(self, name: str, given: Namespace, client: ServiceClient) -> None:
        self.name, self.given, self.client = name, given, client
        self.moving = False  # while the machine may move because of this run
        begun = datetime.now(UTC)
        self._file: Path = given.protocol or Path(f"{name}-{begun:%Y%m%dT%H%M%SZ}.json")
        self.protocol: Json = {
            "runbook": name,
            "by": given.by,
            "begun": begun.isoformat(),
            "ended": None,
            "service": given.url,
            "dry_run": given.dry_run,
            "robot": None,
            "versions": {"sweepid": version("sweepid"), "python": platform.python_version()},
            "steps": [],
            "result": "under way",
            "exit_code": None,
        }

    def step(self, what: str, result: str, left: float | None = None, **details: object) -> None:
        """Print a line and add an entry to the protocol. `left`: remaining time of the campaign, s."""
        time_left = "" if left is None else f", {minutes(left)} left"
        print(f"{what}: {result}{time_left}", flush=True)
        entry = {"at": datetime.now(UTC).isoformat(), "step": what, "result": result, "left_s": left}
        self.protocol["steps"].append(entry | details)
        self.write()

    def write(self) -> None:
        """Write the protocol. After an error the old file is unchanged. BadInput if it cannot be written."""
        fresh = self._file.with_name(f"{self._file.name}.part")
        try:
            fresh.write_text(json.dumps(self.protocol, indent=1) + "\n", "utf-8")
            fresh.replace(self._file)
        except OSError as error:
            raise BadInput(str(self._file), f"the protocol cannot be written: {error.strerror}") from None

    def identify_machine(self, robot: Json) -> Robot:
        """Write robot, service and drives to the protocol. Returns the robot from the document of the service."""
        self.protocol["robot"] = {"id": robot["id"], "name": robot["name"]}
        drives = {axis["joint"]: axis["identity"] for axis in self.client.drives()["axes"]}
        self.protocol["versions"] |= {"service": self.client.version(), "drives": drives}
        return robot_of(robot)

    def robot_named(self, name: str) -> Json:
        """The robot of the machine, or the newest one with this name. BadInput if there is none."""
        own = [one["robot_id"] for one in self.client.machines()["items"] if one["here"]]
        found = [robot for robot in self.client.robots() if robot["name"] == name]
        found.sort(key=lambda robot: robot["id"] in own)
        if not found:
            raise BadInput(
                "robot", f"{self.given.url} has no robot {name}: store it first, for example with commission.py"
            )
        return self.client.robot(found[-1]["id"])

    @property
    def typed(self) -> dict[str, str | None]:
        """Names that the person typed, of a robot or cell that is not the machine's."""
        return {"confirm_robot": self.given.confirm_robot, "confirm_cell": self.given.confirm_cell}

    def planned(self, request: Json) -> Json:
        """A plan for the machine."""
        robot, cell = self.given.confirm_robot, self.given.confirm_cell
        return self.client.add_plan(request, confirm_robot=robot, confirm_cell=cell)

    def cell(self) -> str:
        """The cell of `--cell`; empty: that of the machine."""
        return self.given.cell or ""

    def agreed(self, question: str, word: str) -> bool:
        """Whether the person typed `word`. The answer is no if there is no input."""
        if self.given.yes:
            return True
        try:
            return input(f'{question} Type "{word}": ').strip() == word
        except EOFError:
            return False

    def findings(self, found: Sequence[Json]) -> Exit:
        """Print the findings of a data check: red for wrong data, amber for warnings."""
        for one in found:
            self.step(f"data, {one['severity']}", f"{one['sentence']} {one['action']}", finding=one)
        if not found:
            self.step("data", "nothing found")
        severities = {one["severity"] for one in found}
        return Exit.FAILED if "wrong" in severities else Exit.AMBER if severities else Exit.DONE

    def completed(self, number: int) -> Json:
        """A campaign of the given robot; BadInput if it is of another one or not completed."""
        campaign = self.client.campaign(number)
        name = {robot["id"]: robot["name"] for robot in self.client.robots()}[campaign["robot_id"]]
        if name != self.given.robot:
            raise BadInput("robot", f"campaign {number} is of {name}, not of {self.given.robot}")
        if campaign["state"] != "completed":
            raise BadInput("campaign", f"campaign {number} is {campaign['state']}, not completed")
        return campaign

    def repeated(self, robot: Robot, before: Json) -> Json | Exit:
        """The completed campaign given as `--after`, or the plan of `before` measured again; the exit code if there is
        nothing to compare.
        """
        if self.given.after is not None:
            after = self.completed(self.given.after)
            if self.given.dry_run:
                self.step("compare", "moves nothing")
                return Exit.DONE
            return after
        if before["plan_id"] is None:
            raise BadInput(
                "before", f"campaign {before['id']} was imported and has no plan to measure again: give --after too"
            )
        return self.measured(robot, self.client.plan(before["plan_id"]))

    def tell_moves(self, robot: Robot, sweeps: Sequence[Json], indent: str = "") -> None:
        """Print the motion of a plan's sweeps for each axis, from the present positions."""
        stands = {axis["joint"]: axis["position"] for axis in self.client.drives()["axes"]}
        for move in moves(robot, sweeps, stands):
            self.step(f"{indent}{move.joint}", told(move), motion=move.document())

    def tell_ahead(self, ahead: Json) -> Json:
        """Print robot, cell, machine and approach. Returns the ranges of the axes, for the start."""
        self.step("plan of", PlanSubject.model_validate(ahead["subject"]).sentence)
        legs = ", ".join(f"{leg['joint']} to {leg['target']:.4g}" for leg in ahead["approach"])
        self.step("approach", f"not known: {ahead['trouble']}" if ahead["trouble"] else legs or "none", ahead=ahead)
        return ahead["range"]

    def measured(self, robot: Robot, plan: Json) -> Json | Exit:
        """Print a plan and run it. Returns the completed campaign, or the exit code if it ended otherwise or in a dry
        run. KeyboardInterrupt if declined.
        """
        document = plan["document"]
        self.step(
            f"plan {plan['id']}",
            f"{len(document['sweeps'])} sweeps, {minutes(plan['expected_time'])}; first each axis moves half a degree "
            "and back",
            plan=plan["id"],
            duration_s=plan["expected_time"],
        )
        for dropped in document.get("dropped", ()):  # a plan of trajectories has none
            self.step("left out", dropped["reason"])
        if not self.given.dry_run and not self.client.drives()["connected"]:
            self.client.connect()
        self.tell_moves(robot, document["sweeps"])
        seen = self.tell_ahead(self.client.plan_ahead(plan["id"]))
        if self.given.dry_run:
            return Exit.DONE
        if not self.agreed("Is the cell clear, may the machine move?", "yes"):
            raise KeyboardInterrupt
        number = int(self.client.add_campaign(plan["id"])["id"])
        campaign = self.watched(number, lambda: self.client.start(number, seen=seen))
        return campaign if campaign["state"] == "completed" else self.not_completed(campaign)

    def watched(self, campaign_id: int, begin: Callable[[], object]) -> Json:
        """Start or resume a campaign and report its sweeps. Returns the campaign when it is over or paused."""
        before = {sweep["number"]: sweep["attempt"] for sweep in self.client.sweeps(campaign_id)}
        self.protocol["campaign"] = campaign_id
        self.moving = True
        begin()
        return self.followed(campaign_id, before)

    def followed(self, campaign_id: int, before: Mapping[int, int]) -> Json:
        """Report the sweeps of a running campaign. Returns the campaign when it is over or paused.

        `before`: number of attempts of each sweep before this run.
        """
        self.step(f"campaign {campaign_id}", "started", self.client.campaign(campaign_id)["progress"]["remaining"])
        for event in self.client.events(campaign_id):
            data = event["data"]
            campaign = self.client.campaign(campaign_id)
            if event["kind"] == "sweep" and data["state"] in TOLD and data["attempt"] > before[data["number"]]:
                what = f"sweep {data['number']} of {len(before)}, {data['axis']}"
                result = f"{data['state']}{': ' if data['cause'] else ''}{data['cause']}"
                self.step(what, result, campaign["progress"]["remaining"], sweep=data)
            if campaign["state"] in OVER:
                break
        self.moving = False
        self.step(f"campaign {campaign_id}", ending(campaign), state=campaign["state"], cause=campaign["cause"])
        return campaign

    def not_completed(self, campaign: Json) -> Exit:
        """Exit code of a paused or aborted campaign: stopped by a person, or failed."""
        stops = self.client.stops()
        for stop in stops:
            self.step(f"stop {stop['id']}", f"latched by {stop['by']}: {stop['why']}", stop=stop)
        person = campaign["state"] == "aborted" or campaign["cause"] == BY_REQUEST
        code = Exit.STOPPED if person or any(stop["by"] != HOST_WATCH for stop in stops) else Exit.FAILED
        self.step("ended by", "a person" if code is Exit.STOPPED else "a fault", cause=campaign["cause"])
        return code


def minutes(seconds: float) -> str:
    return "{}:{:02d}".format(*divmod(max(0, round(seconds)), 60))


def ending(campaign: Json) -> str:
    return f"{campaign['state']}{': ' if campaign['cause'] else ''}{campaign['cause']}"


def told(move: Move) -> str:
    """The motion of an axis as text: range in deg or mm, motion of the arm's end in mm, duration."""
    low, high = move.range_shown()
    arm = "" if move.arm_mm is None else f" (the arm's end by up to {move.arm_mm:.0f} mm)"
    time = (
        f"{move.seconds:.0f} s of sweeps with the paths to them" if move.seconds else "on paths to poses of other axes"
    )
    return f"{low:.1f} to {high:.1f} {move.unit}{arm}, {time}"


def run(name: str, parser: ArgumentParser, work: Callable[[Runbook], Exit]) -> int:
    """Run a runbook, from its arguments to its exit code."""
    given = parser.parse_args()
    with ServiceClient(given.url) as client, TerminationSignals() as signals:
        book = Runbook(name, given, client)
        code, result = Exit.FAILED, "failed"
        try:
            book.write()
            code = work(book)
            result = OUTCOME[code]
        except BaseException as error:
            told_by = signals.by
            signals.by = told_by or type(error).__name__  # later signals wait: the stop is sent first
            stop = stopped(book, signals.by) if book.moving else ""
            if isinstance(error, KeyboardInterrupt):
                code, result = Exit.STOPPED, f"stopped: {told_by or 'not confirmed'}"
            elif isinstance(error, SweepidError):
                code = Exit.BAD_INPUT if isinstance(error, BadInput) and not stop else Exit.FAILED
                result = str(error)
            elif isinstance(error, BrokenPipeError):
                result = "the output was closed, nobody reads it"
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the lines that are not flushed yet
            else:
                result = f"{type(error).__name__}: {error}"
            result += stop
            if not isinstance(error, KeyboardInterrupt | SweepidError | BrokenPipeError):
                raise
        finally:
            book.protocol |= {"ended": datetime.now(UTC).isoformat(), "result": result, "exit_code": int(code)}
            try:
                book.write()
            except BadInput as error:
                result = result if str(error) in result else f"{result}; {error}"
            print(f"{name}: {result}", file=sys.stderr if code else sys.stdout, flush=True)
    return int(code)


def stopped(book: Runbook, why: str) -> str:
    """Stop the machine. Returns the text about it for the person."""
    try:
        book.client.stop(book.name, why)
    except SweepidError as error:
        return f"; THE STOP IS NOT CONFIRMED: {error}; look at the machine"
    return "; machine stopped; next: after_a_stop.py"


def optional_list(text: str) -> list[str]:
    """Names, separated by commas."""
    return [name for name in text.split(",") if name]


def request_of(plan: Json) -> dict[str, Any]:
    """The request of a stored plan, without its budget."""
    request = plan["document"]["request"]
    return {name: value for name, value in request.items() if name not in ("poses", "duration", "confidence")}
