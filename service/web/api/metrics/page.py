"""Writes `docs/reference/metrics.md` from the figures: ``python -m service.web.api.metrics.page > FILE``."""

import sys

from service.web.api.metrics import machine, plant, quality, work

GROUPS = {
    "Machine and bus": machine.FIGURES,
    "Recorder, queue, disk and database": work.FIGURES,
    "Machines of the plant": plant.FIGURES,
    "Identification": quality.FIGURES,
}


def page() -> str:
    """The reference page, as Markdown."""
    lines = [
        "# Metrics",
        "",
        (
            "Generated from the figures in `service/web/api/metrics`; `GET /metrics` returns them in the "
            "format of Prometheus."
        ),
        "With the setting `login: true` a key with the scope `metrics` is enough: [Permissions](permissions.md).",
        "`machine` is the name of a machine. A service without one (`--no-machine`) gives no figure of its own.",
        "A value that is not known is omitted; it is never reported as 0.",
    ]
    for group, figures in GROUPS.items():
        lines += ["", f"## {group}", "", "| metric | kind | meaning |", "|---|---|---|"]
        for figure in figures:
            lines.append(f"| `{figure.shown}` | {'counter' if figure.counter else 'gauge'} | {figure.help} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
