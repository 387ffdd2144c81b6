"""Records without lines on an elastic axis: fitted as rigid, they must not promise more than they keep."""

from dataclasses import replace
from typing import Any

import numpy as np

from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import spectrum
from tests.numeric.campaign import measure


def test_what_the_spring_does_to_a_rigid_fit_is_in_the_deviation() -> None:
    """The same recordings of joint_1 once more, told without their lines."""
    campaign = measure("max100-full", seed=17, poses=8)
    free = {"excitation": "trajectory", "sines": (), "period": None, "periods": None, "measure_from": 0.0}
    told = [
        replace(sweep, spec=sweep.spec.model_copy(update={**free, "id": f"free {sweep.spec.id}"}))
        for sweep in campaign.sweeps[:8]
    ]
    spectra = [spectrum(campaign.robot, sweep) for sweep in (*campaign.sweeps, *told)]
    estimate = identify(campaign.robot, spectra)
    truth = dict(zip((sweep.spec.id for sweep in told), campaign.truth("joint_1"), strict=True))
    document: Any = as_document(estimate, estimate.workspace).as_json()
    entries = document["axes"]["joint_1"]["inertia"]
    records = [entry for entry in entries if entry["sweep"] in truth]
    z = [(entry["value"] - truth[entry["sweep"]]) / entry["std"] for entry in records]
    error = [100 * (entry["value"] / truth[entry["sweep"]] - 1) for entry in records]
    print(f"free records: median error {np.median(error):.1f} %, {np.round(z, 1)} standard deviations")
    assert np.median(error) > 2
    assert np.abs(z).max() < 3
    assert any("fitted as a rigid axis; its spring is good for an error of" in e.get("warning", "") for e in records)
    assert not any("warning" in entry for entry in entries if entry["sweep"] not in truth)
