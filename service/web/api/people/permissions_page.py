"""Makes `docs/reference/permissions.md`: ``python -m service.web.api.people.permissions_page > FILE``."""

import sys

from service.store.access.permissions import MEANING, PERMISSIONS, SCOPES, Role, scope_of


def page() -> str:
    """The reference page, as Markdown."""
    rows = [
        f"| `{method}` | `{path}` | {_word(role)} | {scope_of((method, path)) or ''} |".replace("  |", " |")
        for (method, path), role in PERMISSIONS.items()
    ]
    lines = [
        "# Permissions",
        "",
        "Generated from the table in `service/store/access/permissions.py`. It holds with the setting `login: true`;",
        "without it, every client is `local` and may do everything:",
        "[Let others in](../how-to/let-others-in.md).",
        "",
        "| role | permissions, in addition to those of the roles above |",
        "|---|---|",
        *(f"| {role.word} | {MEANING[role]} |" for role in Role),
        "",
        "STOP requires no login, here and at the port of the stop process.",
        "",
        "A key may be limited to scopes (`sweepid people add-key --scope WORD`), and then needs both role and scope.",
        "",
        "| scope | gives access to |",
        "|---|---|",
        *(f"| {scope} | {opens} |" for scope, opens in SCOPES.items()),
        "",
        "| method | path | least role | scope |",
        "|---|---|---|---|",
        *rows,
    ]
    return "\n".join(lines) + "\n"


def _word(role: Role | None) -> str:
    return "no login" if role is None else role.word


if __name__ == "__main__":
    sys.stdout.write(page())
