"""Measure until the required confidence is reached, and report the cause of the end in the morning.

    python overnight.py max100-class --axes joint_2,joint_3 --varied joint_3 --confidence 0.3 --by "your name"

It ends after a stop or a fault and never resumes a campaign automatically. Exit codes: 0 confidence reached, 1 paused
by a fault, 2 bad input, 3 stopped by a person, 4 no sweeps left before the confidence was reached.
"""

import sys

from reached import confidence
from runbook import CELL_HELP, Exit, Runbook, optional_list, parser_of, run


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("robot", help="name of a robot that is stored in the service")
    parser.add_argument("--axes", type=optional_list, required=True, help="joints to measure, comma separated")
    parser.add_argument("--varied", type=optional_list, required=True, help="joints that make the poses")
    parser.add_argument("--confidence", type=float, required=True, help="largest std of J over the workspace, percent")
    parser.add_argument("--cell", help=CELL_HELP)
    parser.add_argument("--step", type=float, default=5.0, help="deg (cm) between the positions of the grid")
    return run("overnight", parser, overnight)


def overnight(book: Runbook) -> Exit:
    given = book.given
    document = book.robot_named(given.robot)
    robot = book.identify_machine(document)
    request = {"robot_id": document["id"], "cell": book.cell(), "axes": given.axes, "varied": given.varied}
    plan = book.planned(request | {"step": given.step, "confidence": given.confidence})
    campaign = book.measured(robot, plan)
    if isinstance(campaign, Exit):
        return campaign
    return confidence(book, campaign, given.axes, given.confidence)


if __name__ == "__main__":
    sys.exit(main())
