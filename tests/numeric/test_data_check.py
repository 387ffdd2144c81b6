"""The check of the data: nothing on sound bundles, each fault by its name. What it makes of many is in the scores of
the second plant.
"""

from pathlib import Path

import numpy as np
import pytest

from service.data_check import check, untrustworthy
from service.formats.traces.trace_import import import_trace
from service.store.files.bundle import read_bundle
from tests.numeric.check_faults import FAULTS, Sound, sound
from tests.numeric.second_plant.cases import Case, Kind, make
from tests.numeric.second_plant.faults import FAULTS as OF_THE_PLANT
from tests.numeric.second_plant.scoring import told

CLEAN = 8  # bundles
NUMBERS = {"axes_swapped": 3}  # of the case: in the first two of this fault nothing is found
CARRIER = 7  # of sound bundles: with holds and repeats, it carries all faults


def test_nothing_is_found_in_sound_bundles() -> None:
    bundles = [sound(number).bundle for number in range(CLEAN)]
    assert [check(bundle.robot, bundle.sweeps) for bundle in bundles] == [()] * CLEAN


@pytest.fixture(scope="module")
def carrier() -> Sound:
    return sound(CARRIER)


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_by_name(carrier: Sound, name: str) -> None:
    broken = FAULTS[name].apply(np.random.default_rng(1), carrier)
    findings = check(broken.robot, broken.sweeps)
    codes = {finding.code for finding in findings}
    assert codes & set(FAULTS[name].codes), codes
    assert all(finding.sentence and finding.action for finding in findings)


@pytest.mark.parametrize("fault", OF_THE_PLANT)
def test_a_fault_of_the_second_plant_is_told(fault: str) -> None:
    robot, _, sweeps, truth = make(Case(51, NUMBERS.get(fault, 1), Kind.NOMINAL, (fault,)), small=True)
    findings = check(robot, sweeps)
    assert truth.fault == fault
    assert told(fault, [finding.code for finding in findings]), findings


def test_nothing_is_found_in_bundles_of_another_plant_but_a_shaking_floor(shared: Path) -> None:
    """The twelfth has floor vibration of 7.3 Hz: a warning, which forbids no physics."""
    for folder in sorted(path for path in (shared / "data/foreign").iterdir() if path.is_dir()):
        bundle = read_bundle(folder)
        findings = check(bundle.robot, bundle.sweeps)
        if folder.name != "12":
            assert findings == (), folder.name
            continue
        (finding,) = findings
        assert finding.code == "not_repeatable"
        assert "at 7.3 Hz" in finding.sentence
        assert untrustworthy(findings, "joint_2") == ()


def test_nothing_is_found_in_a_measured_trajectory(root: Path, shared: Path) -> None:
    robot, sweeps = import_trace(root / "config/traces/emps.yaml", shared / "data/emps/DATA_EMPS.mat")
    assert check(robot, sweeps) == ()
