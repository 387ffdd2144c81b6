"""What the service says in sentences (`tests/browser/test_german.py`: all that a page can show is in the catalogue).

A page finds code (`said.CODE` of the catalogue) and values of a sentence by its English text, so that text is the
service's own, word for word.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.web.hmi.pages import texts

SAID = {key: text for key, text in texts()["en"].items() if key.startswith("said.")}
VALUE = "\0"  # in place of a value
# put together of choices: the service has all of their words, but not side by side
COMPOSED = {
    *("falls-it", "falls-them", "falls-it-noise", "falls-them-noise", "reach-only", "reach-none", "type-robot"),
    *("type-cell", "type-both", "choose-fit", "choose-none", "key-unknown", "session-unknown"),
}


def template(node: ast.expr) -> str:
    """The text of an expression, with `VALUE` in place of what it inserts."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(template(one) for one in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return template(left) + template(right)
        case _:
            return VALUE


def pieces(text: str) -> Iterator[str]:
    """What stands between values, the words that they are part of, and stops: if it is more than a word."""
    found = (one.strip() for one in re.split(rf"\w*{VALUE}\w*|[.:,;()]", text))
    yield from (one for one in found if " " in one)


def trees(root: Path) -> Iterator[tuple[str, ast.Module]]:
    for path in sorted([*(root / "service").rglob("*.py"), *(root / "drivers").rglob("*.py")]):
        yield path.relative_to(root).as_posix(), ast.parse(path.read_text("utf-8"))


def of_catalogue(text: str) -> str:
    return "".join(piece if k % 2 == 0 else VALUE for k, piece in enumerate(text.replace("}", "{").split("{")))


def not_in(written: str, text: str) -> bool:
    return any(piece not in written for piece in pieces(of_catalogue(text)))


@pytest.mark.slow
def test_each_sentence_is_one_of_the_service(root: Path) -> None:
    written = "\n".join(
        template(node)
        for _, tree in trees(root)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp)
    )
    other = {key.removeprefix("said.") for key, text in SAID.items() if not_in(written, text)}
    assert other == COMPOSED


@pytest.mark.parametrize("language", [one for one in texts() if one != "en"])
def test_no_sentence_is_left_as_it_is(language: str) -> None:
    assert [key for key, text in SAID.items() if texts()[language][key] == text] == []
