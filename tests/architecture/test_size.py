"""What the house has reached stays: figures of `tests.architecture.size`, and the glossary."""

import re

from tests.architecture.size import ROOT, figures

LIMITS = {
    "rooms of the service": 14,
    "layers of the service": 8,
    "class names defined twice or more": 4,
    "constants of modules": 600,
    "import statements per 1,000 lines": 54,
    "words of the documents": 60_000,
}
TERMS = 120  # of the glossary


def test_no_figure_grows_above_its_limit() -> None:
    found = dict(figures())
    assert {name: found[name] for name, limit in LIMITS.items() if int(found[name]) > limit} == {}


def test_the_glossary_stays_short_and_has_each_term_once() -> None:
    page = (ROOT / "docs/reference/words.md").read_text("utf-8").partition("## In German")[0]
    terms = [term for term in re.findall(r"^\| ([^|]+?) +\|", page, re.MULTILINE) if term != "term"]
    assert 50 < len(terms) <= TERMS
    assert len(set(terms)) == len(terms)
