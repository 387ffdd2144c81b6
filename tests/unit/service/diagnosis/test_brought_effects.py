"""Effects that installed packages bring: found by entry point, behind the shipped ones; what is broken names itself."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.catalogue import Catalogue
from service.errors import BadInput

SHIPPED = tuple(CATALOGUE.values())  # of this process: looked at before anything is installed
EFFECT = """
from dataclasses import replace
from service.diagnosis.effects.friction.coulomb_friction import EFFECT as SHIPPED
EFFECT = replace(SHIPPED, name="{name}")
"""


class Packages:
    """A folder on the path, as an installer fills it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.modules: set[str] = set()

    def install(self, package: str, entries: dict[str, str], modules: dict[str, str] | None = None) -> None:
        info = self.folder / f"{package}-2.1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 2.1\n")
        lines = [f"{name} = {value}\n" for name, value in entries.items()]
        (info / "entry_points.txt").write_text("".join(["[sweepid.effects]\n", *lines]))
        for name, text in (modules or {}).items():
            (self.folder / f"{name}.py").write_text(text)
            self.modules.add(name)


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Packages]:
    monkeypatch.syspath_prepend(tmp_path)
    found = Packages(tmp_path)
    yield found
    for name in found.modules:
        sys.modules.pop(name, None)


def catalogue() -> Catalogue:
    """As the next process has it."""
    return Catalogue(SHIPPED)


def test_they_stand_behind_the_shipped_ones_by_name(packages: Packages) -> None:
    entries = {"wear": "many_effects:WEAR", "drag": "many_effects:EFFECT"}
    text = EFFECT.format(name="drag") + 'WEAR = replace(SHIPPED, name="wear")\n'
    packages.install("many", entries, {"many_effects": text})
    found = catalogue()
    assert list(found) == [*CATALOGUE, "drag", "wear"]
    assert len(found) == len(CATALOGUE) + 2
    assert found["drag"].name == "drag"
    assert found.brought == {"drag": "many 2.1", "wear": "many 2.1"}
    assert CATALOGUE.brought.keys().isdisjoint(CATALOGUE)


def test_one_that_imports_the_catalogue_itself_is_found(packages: Packages) -> None:
    """As in a test of that package, which imports its module before anything of ours."""
    text = "from service.diagnosis.effects import CATALOGUE\n" + EFFECT.format(name="circular")
    packages.install("circular", {"circular": "circular_effect:EFFECT"}, {"circular_effect": text})
    assert "circular" in catalogue()


@pytest.mark.parametrize(
    ("value", "text", "reason"),
    [
        ("bad_a:EFFECT", "import no_such_module", "cannot be loaded: ModuleNotFoundError: No module named 'no_such_m"),
        ("bad_b:EFFECT", "1 / 0", "cannot be loaded: ZeroDivisionError: division by zero"),
        ("bad_c:EFFECT", "EFFECT = (", "cannot be loaded: SyntaxError: '(' was never closed"),
        ("bad_d:EFFECT", "", "cannot be loaded: AttributeError: module 'bad_d' has no attribute 'EFFECT'"),
        ("bad_e:EFFECT", "EFFECT = 3", "is int, not service.diagnosis.effects.effect.Effect"),
        ("bad_f:EFFECT", EFFECT.format(name="other"), "its effect calls itself 'other': both must have the same name"),
    ],
)
def test_what_is_broken_is_told_with_package_and_entry_point(
    packages: Packages, value: str, text: str, reason: str
) -> None:
    packages.install("bad", {"magic": value}, {value.partition(":")[0]: text})
    found = catalogue()
    for look in (lambda: found["coulomb_friction"], lambda: list(found), lambda: found.brought):  # at every look
        with pytest.raises(BadInput) as told:
            look()
        assert str(told.value).startswith(f"package bad 2.1, entry point sweepid.effects: magic = {value}: {reason}")


def test_a_name_that_is_taken_is_refused(packages: Packages) -> None:
    packages.install("first", {"wear": "twin_effect:EFFECT"}, {"twin_effect": EFFECT.format(name="wear")})
    assert "wear" in catalogue()
    packages.install("second", {"wear": "twin_effect:EFFECT"})
    with pytest.raises(
        BadInput, match=r"^package second 2\.1, .*: an effect of this name comes with first 2\.1 already"
    ):
        len(catalogue())
    packages.install("again", {"backlash": "again_effect:EFFECT"}, {"again_effect": EFFECT.format(name="backlash")})
    with pytest.raises(BadInput, match=r"^package again 2\.1, .*: an effect of this name comes with sweepid already"):
        len(catalogue())
