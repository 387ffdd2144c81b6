"""Twenty questions of a new engineer: the names of folders and files, and the glossary, lead to the right file.

The search reads no file but `docs/reference/words.md`: a file is worth the rareness of the words of its name that the
question has, half of it for folders, and 0.7 of it for words that the glossary gives for those of the question.
"""

import math
import re
from collections import Counter
from pathlib import Path

import pytest

from tests.architecture.size import PRODUCT, ROOT, files

PAGE = "docs/explanation/architecture.md"
HELD = 19  # of 20


def stem(word: str) -> str:
    short = re.sub(r"(?:ations?|ions?|ings?|ers?|ed|es|s|e)$", "", word) if len(word) > 4 else word.rstrip("s")
    return re.sub(r"([^aeious])\1$", r"\1", short)[:5]


def stems(text: str) -> set[str]:
    return {stem(word) for word in re.findall(r"[a-z]+", text.lower())}


IDLE = stems("where is it the of a an on which does do how to whether may be its for in and or what can")


class Search:
    """Over paths of the product, by their words alone."""

    def __init__(self, glossary: str) -> None:
        paths = [path.relative_to(ROOT) for path in files(*PRODUCT) if path.name != "__init__.py"]
        self._words = {path: (stems(path.stem) - IDLE, stems(" ".join(path.parts[:-1]))) for path in paths}
        self._rare = [Counter(word for words in self._words.values() for word in words[kind]) for kind in (0, 1)]
        rows = re.findall(r"^\| (?!term|---)(.+?) \| (.+) \|$", glossary.partition("## In German")[0], re.MULTILINE)
        self._terms = [
            ([stems(term), *map(stems, re.findall(r"\*([^*]+)\*", row))], stems(re.sub(r"\]\([^)]*\)", "", term + row)))
            for names, row in rows
            for term in names.split(",")
        ]
        self._common = Counter(word for _, entry in self._terms for word in entry)

    def first(self, question: str) -> str:
        """The path that fits best; of those that fit equally, the shortest."""
        asked = stems(question) - IDLE
        likest = max(self._terms, key=lambda term: self._likeness(asked, term[1]))
        told = set[str]().union(
            *(word for names, _ in self._terms if any(name <= asked for name in names) for word in names)
        )
        weight = dict.fromkeys(told | likest[0][0], 0.7) | dict.fromkeys(asked, 1.0)
        return max(self._words, key=lambda path: (self._worth(path, weight), -len(str(path)))).as_posix()

    def _likeness(self, asked: set[str], entry: set[str]) -> float:
        shared = sum(math.log(len(self._terms) / self._common[word]) for word in asked & entry)
        return shared / math.sqrt(len(entry))

    def _worth(self, path: Path, weight: dict[str, float]) -> float:
        name, folder = self._words[path]
        own, above = (
            sum(weight.get(word, 0.0) * math.log(len(self._words) / rare[word]) for word in words)
            for words, rare in zip((name, folder - name), self._rare, strict=True)
        )
        return own / max(len(name), 1) ** 0.2 + 0.5 * above


@pytest.fixture(scope="module")
def questions() -> list[tuple[str, str]]:
    page = (ROOT / PAGE).read_text("utf-8").partition("## Twenty questions")[2]
    return re.findall(r"^- (.+\?) `([\w/]+\.py)`$", page, re.MULTILINE)


def test_each_question_has_a_file(questions: list[tuple[str, str]]) -> None:
    assert len(questions) == 20
    assert [file for _, file in questions if not (ROOT / file).is_file()] == []


def test_names_lead_to_the_file_at_first_try(questions: list[tuple[str, str]]) -> None:
    search = Search((ROOT / "docs/reference/words.md").read_text("utf-8"))
    found = {question: search.first(question) for question, _ in questions}
    right = [question for question, file in questions if found[question] == file]
    assert questions[:HELD] == [(question, found[question]) for question, _ in questions[:HELD]]
    assert len(right) == HELD, "the page tells how many hold, and these come first"
