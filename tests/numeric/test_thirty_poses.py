"""Offline from end to end: a simulated bundle of 30 poses of axes 1 to 3, read from its files by `sweepid identify`."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from service.store.files.bundle import write_bundle
from tests.numeric.campaign import AXES, measure


def test_table_1_of_a_simulated_bundle(tmp_path: Path) -> None:
    campaign = measure("max100-full", seed=31, poses=30)
    write_bundle(tmp_path / "bundle", campaign.robot, campaign.sweeps)
    command = [sys.executable, "-c", "from service.cli import main; main()", "identify", str(tmp_path / "bundle")]
    table = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    print(table)
    document = json.loads(
        subprocess.run([*command, "--json", "-"], capture_output=True, timeout=120, check=True).stdout
    )
    assert len(document["base_parameters"]) == 11
    assert f"{document['condition_number']:.3g}" in table
    for joint in AXES:
        axis = document["axes"][joint]
        assert len(axis["inertia"]) == 30
        assert f"{axis['rmse_percent']['identified_measured']:.2f}" in table
        error = np.array([sweep["value"] for sweep in axis["inertia"]]) / campaign.truth(joint) - 1
        assert np.median(np.abs(error)) < 0.0075
        # the nominal model is off by what the scenario added; the identified one is not
        assert axis["rmse_percent"]["reference_measured"] > 5 > axis["rmse_percent"]["identified_measured"]
