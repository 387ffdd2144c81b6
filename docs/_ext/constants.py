"""Appends every constant of the mathematics with its value to `reference/constants.md`, as the code has them."""

import ast
import re
from collections.abc import Iterable, Iterator, Mapping

from markdown_table import cell, table
from sphinx.application import Sphinx

from tests.constants_page import ROOT, in_code

PAGE = "reference/constants"


def setup(app: Sphinx) -> Mapping[str, bool]:
    app.connect("source-read", _append)
    return {"parallel_read_safe": True}


def _append(_app: Sphinx, document: str, source: list[str]) -> None:
    if document == PAGE:
        source[0] += "\n".join(_listed())


def _listed() -> Iterator[str]:
    files: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for key, value in in_code().items():
        folder, _, name = key.partition(" ")
        file, _, name = name.partition(".")
        files.setdefault((folder, file), []).append((name, value))
    for (folder, file), rows in files.items():
        comments = _comments(folder, file)
        yield f"\n### `{folder}/{file}.py`\n"
        yield from table(("name", "value", "comment in the code"), (_row(*row, comments) for row in rows))


def _row(name: str, value: str, comments: Mapping[str, str]) -> Iterable[str]:
    return f"`{name}`", f"`{value}`".replace("|", "\\|"), cell(comments.get(name, ""))


def _comments(folder: str, file: str) -> Mapping[str, str]:
    """The comment at the end of each assignment, or the text below it, by the names that it assigns."""
    (path,) = (ROOT / folder).glob(f"{file}.py")
    lines, found = path.read_text("utf-8").splitlines(), dict[str, str]()
    tree = ast.parse(path.read_text("utf-8"))
    of_classes = {f"{one.name}.": one.body for one in tree.body if isinstance(one, ast.ClassDef)}
    for prefix, body in ({"": tree.body} | of_classes).items():
        for statement, after in zip(body, [*body[1:], None], strict=True):
            if isinstance(statement, ast.Assign | ast.AnnAssign):
                target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
                comment = re.search(r"#\s*(.*)$", lines[(statement.end_lineno or 0) - 1])
                text = (
                    after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
                )
                found[prefix + ast.unparse(target).strip("()")] = comment[1] if comment else str(text)
    return found
