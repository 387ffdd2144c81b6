"""What the service says in sentences: the pages have those of a shift in each language, and the others are listed here.

A page finds code (`said.CODE` of the catalogue) and values of a sentence by its English text, so that text is the
service's own, word for word.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.web.hmi.pages import texts

SAID = {key: text for key, text in texts()["en"].items() if key.startswith("said.")}
VALUE = "\0"  # in place of a value
TOLD = ("Conflict", "Superseded", "NotNow", "DataFinding")  # refusals, and findings of the data check
# refusals and findings that a page shows in English, by module. The words of a person, of a log (behind a cause, whose
# sentence is in the catalogue), of a drive's maker and of a diagnosis' figures and summary stay as they are as well
LEFT = {
    "service/jobs/diagnosing.py": (3, "choices that the page does not offer, and a test mass: rare"),
    "service/jobs/experiments.py": (1, "two people accept at once: rare"),
    "service/jobs/reporting.py": (2, "of the report, which is English"),
    "service/store/diagnoses.py": (1, "two people accept at once: rare"),
    "service/store/documents.py": (1, "of the report, which is English"),
    "service/store/files/data_folder.py": (1, "of the command `export`"),
    "service/store/lease_and_latch.py": (1, "of programs that repeat a request"),
    "service/store/people/users.py": (3, "of the commands `people`"),
    "service/store/plant.py": (1, "of programs: the page offers no sheet without a result"),
    "service/store/retention.py": (2, "of the commands `data`"),
    "service/web/api/diagnoses.py": (1, "of programs: the page orders no unattended experiments"),
    "service/web/api/login.py": (2, "of programs: the page asks for no login where there is none"),
    "service/web/api/oidc.py": (2, "names settings, for who installs the service"),
    "service/web/api/plans.py": (1, "of programs: the page asks for no grid of an imported plan"),
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
    """What stands between the values and the words that they are part of, if it is more than a word."""
    found = (one.strip(" .:,;()") for one in re.split(rf"\w*{VALUE}\w*", text))
    yield from (one for one in found if " " in one)


def trees(root: Path) -> Iterator[tuple[str, ast.Module]]:
    for path in sorted([*(root / "service").rglob("*.py"), *(root / "drivers").rglob("*.py")]):
        yield path.relative_to(root).as_posix(), ast.parse(path.read_text("utf-8"))


def of_catalogue(text: str) -> str:
    return "".join(piece if k % 2 == 0 else VALUE for k, piece in enumerate(text.replace("}", "{").split("{")))


@pytest.mark.slow
def test_each_sentence_is_one_of_the_service(root: Path) -> None:
    written = "\n".join(
        template(node)
        for _, tree in trees(root)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp)
    )
    other = [key for key, text in SAID.items() if any(piece not in written for piece in pieces(of_catalogue(text)))]
    assert other == []


@pytest.mark.slow
def test_what_a_page_shows_in_english_is_listed(root: Path) -> None:
    known = "\n".join(map(of_catalogue, SAID.values()))
    left: Counter[str] = Counter()
    for module, tree in trees(root):
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in TOLD:
                told = [template(one) for one in node.args]
                left[module] += any(piece not in known for one in told for piece in pieces(one))
    assert {module: count for module, count in left.items() if count} == {
        module: count for module, (count, _) in LEFT.items()
    }


@pytest.mark.parametrize("language", [one for one in texts() if one != "en"])
def test_no_sentence_is_left_as_it_is(language: str) -> None:
    assert [key for key, text in SAID.items() if texts()[language][key] == text] == []
