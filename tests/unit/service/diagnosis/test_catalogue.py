"""Every entry of the catalogue is complete, and its columns are what its names promise; effects of packages."""

import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from service import BadInput
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.drive_train import missing
from service.diagnosis.effects.effect import Catalogue, Model
from service.diagnosis.effects.friction import warmth
from service.diagnosis.rows.signals import Tracks, bristle, tracks
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import full_design
from tests.numeric.campaign import max100


@pytest.fixture(scope="module")
def motion() -> Tracks:
    robot = max100()
    poses = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.5, -0.9, 0, 0, 0]])
    designed = full_design(robot, "joint_2", poses, repeats=1)
    return tracks(robot, "joint_2", [expected(sweep, sweep.spec.pose[1]) for sweep in designed])


def model_of(motion: Tracks, inertia: float = 300.0, viscous: float = 200.0, *, weight: float = 1.0) -> Model:
    """A motor of 66 kg m^2 that carries so much of CAD's weight."""
    none = np.zeros(len(motion.specs))
    return Model(none + inertia, 66.0, viscous, weight * motion.gravity, none, none, np.zeros_like(motion.effort))


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_columns_names_and_bounds_agree(name: str, motion: Tracks) -> None:
    effect, model = CATALOGUE[name], model_of(motion)
    assert effect.applies(motion)
    shapes = effect.shape(motion, model)
    assert all(shape.low <= value <= shape.high for shape in shapes for value in shape.grid)
    shape = next(product(*(one.grid for one in shapes)))
    columns = effect.columns(motion, model, shape)
    assert len(columns) == len(effect.coefficients(motion))
    assert effect.by_load == (not columns) == (effect.readout is not None)
    assert effect.by_load or len(columns) > effect.essential
    for column in columns:
        assert column.shape == motion.velocity.shape
        assert np.isfinite(column).all()
    for text in (effect.physics, effect.source, effect.sentence, effect.entry):
        assert text


def test_bristles_follow_dahl(motion: Tracks) -> None:
    """From rest over a way of three bristle lengths: 1 - exp(-3)."""
    row, way = 0, 1e-3
    gone = motion.position[row] - motion.position[row, 0]
    here = int(np.searchsorted(gone, 3 * way))
    assert bristle(motion.position, way)[row, here] == pytest.approx(1 - np.exp(-gone[here] / way), rel=1e-9)


def test_a_gear_that_hardly_cools_is_as_warm_as_it_has_gone_far(motion: Tracks) -> None:
    way = np.sum(np.abs(motion.velocity) * motion.inside) / motion.rate
    last = max(range(len(motion.specs)), key=lambda k: motion.specs[k].started_at)
    assert warmth(motion, 1e9)[last, -1] == pytest.approx(way, rel=1e-6)


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_columns_that_depend_on_the_fitted_model_say_so(name: str, motion: Tracks) -> None:
    """Others are kept when the model moves."""
    effect, weight = CATALOGUE[name], float(name != "backlash")  # weight keeps the flanks together
    shape = next(product(*(one.grid for one in effect.shape(motion, model_of(motion)))))
    one, other = (
        effect.columns(motion, model_of(motion, inertia, viscous, weight=weight), shape)
        for inertia, viscous in ((300.0, 200.0), (350.0, 250.0))
    )
    assert effect.of_model == any(not np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_play_found_in_many_shapes_at_once_is_that_of_each(motion: Tracks) -> None:
    effect, model = CATALOGUE["backlash"], model_of(motion, weight=0.0)
    shapes = [(1e-5, 0.5), (1e-4, 0.2), (3e-4, 0.9)]
    assert effect.scan is not None
    for shape, found in zip(shapes, effect.scan(motion, model, shapes), strict=True):
        assert found[0].any()
        assert np.array_equal(found[0], effect.columns(motion, model, shape)[0])


def test_within_a_very_wide_play_the_motor_never_meets_the_load(motion: Tracks) -> None:
    """Without gravity and friction the load stays at rest: all of its inertia torque is missing."""
    inertia, none = np.array([250.0]), np.zeros(1)
    weightless = np.zeros_like(motion.gravity)
    lost = missing(motion, weightless, np.array([0]), inertia, none, np.array([10.0]))[0, 0]
    expected_torque = -250.0 * motion.acceleration[0]
    middle = slice(20, -20)
    assert lost[middle] == pytest.approx(expected_torque[middle], abs=0.02 * float(np.abs(expected_torque).max()))


SHIPPED = tuple(CATALOGUE.values())  # of this process: looked at before anything is installed
EFFECT = """
from dataclasses import replace
from service.diagnosis.effects.friction import COULOMB_FRICTION as SHIPPED
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
        ("bad_e:EFFECT", "EFFECT = 3", "is int, not service.diagnosis.effects.effect.CatalogueEffect"),
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
