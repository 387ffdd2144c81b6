"""What the sources of the pages say: the keys that they use, and words that stand in no catalogue."""

import re
from html.parser import HTMLParser
from pathlib import Path

import service.web.hmi.pages as pages

STATIC = Path(pages.__file__).parent / "static"
SCRIPTS = {path.name: path.read_text("utf-8") for path in sorted(STATIC.glob("*.js"))}
DOCUMENTS = {path.name: path.read_text("utf-8") for path in sorted(STATIC.glob("*.html"))}

SAME_IN_ALL = {"sweepid", "STOP", "F8", "CAD", "kg", "kg m²", "mm", "y", "z", "Iyy", "Izz"}
"""Names, units and the stop."""
_SHOWN = ("title", "placeholder", "aria-label", "alt")  # attributes that a person reads or hears
_KEYED = ("data-text", *(f"data-{name}" for name in _SHOWN))
_COMMENT = re.compile(r"(?m)(^|\s)//\s.*$")
_LITERAL = re.compile(r'"((?:[^"\\\n]|\\.)*)"')
_TEMPLATE = re.compile(r"`([^`]*)`")
_INSERTED = re.compile(r"\$\{[^}]*\}")
_KEY = re.compile(r"(?:text|parts|Told)\(\s*(?:\w+ \? )?\"([\w.-]+)\"")
_WORDS = re.compile(r"[A-Za-z]{2,}[,.:;]? [a-z(]|^[A-Z][a-z]+( |$)")
# text given to what writes on the page
_WRITTEN = re.compile(
    r"(?:tell\(\s*\"[^\"]+\"|element\(\s*\"[^\"]+\"|textContent =|(?<!data-)new (?:Error|Option)\(|link\()"
    r"[,\s]*([\"`])((?:(?!\1).)*)\1"
)
_LETTERS = re.compile(r"[A-Za-z]{2,}")
_BESIDE = re.compile(r"\b[A-Za-z]{2,}[,.:;]? | [a-z]{2,}")  # a word beside what a template inserts


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.keys: set[str] = set()
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.keys |= {value for name, value in attrs if name in _KEYED and value}
        self.words += [f"{name}={value}" for name, value in attrs if name in _SHOWN and value]

    def handle_data(self, data: str) -> None:
        if data.strip() and data.strip() not in SAME_IN_ALL:
            self.words.append(data.strip())


def read(document: str) -> _Reader:
    reader = _Reader()
    reader.feed(document)
    return reader


def literals(script: str) -> list[str]:
    """Strings of a script."""
    return _LITERAL.findall(_COMMENT.sub(r"\1", script))


def _templates(code: str) -> list[str]:
    """What stands in templates, without what they insert."""
    return [piece for found in _TEMPLATE.findall(code) for piece in _INSERTED.sub("\0", found).split("\0")]


def named(script: str) -> set[str]:
    """Keys that a script asks for by name."""
    return set(_KEY.findall(script))


def words(script: str) -> list[str]:
    """What a person would read, and what is written on the page as it stands."""
    code = _COMMENT.sub(r"\1", script)
    written = [_INSERTED.sub("", text) for _, text in _WRITTEN.findall(code)]
    beside = [one.strip() for one in _templates(code) if _BESIDE.search(one)]
    return (
        [one for one in literals(script) if _WORDS.search(one)]
        + [one for one in written if _LETTERS.search(one)]
        + beside
    )
