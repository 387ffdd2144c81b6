"""What a campaign's report is made of: read from a real store, with the manifests of real recordings."""

from typing import Any

import pytest

from service import Conflict, NotFound
from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import spectrum
from service.jobs.reporting import CONVERGENCE, Reporting, spread
from service.model import Robot
from service.planning.campaigns.state_machine import SweepEvent, sweep_move
from service.store.diagnoses import DiagnosisStore
from service.store.documents import BoltedMass, NewDiagnosis, NewSweep, SweepState
from service.store.files.data_folder import campaign_bundle
from service.store.store import CheckStore
from tests.stored.documents import diagnosis, diagnosis_document, stored
from tests.unit.service.campaigns.conftest import POSES, SPECTRUM, Bench, spec


def reporting(bench: Bench) -> Reporting:
    return Reporting(bench.store, DiagnosisStore(bench.database), CheckStore(bench.database), bench.files)


def identify(bench: Bench, document: dict[str, Any], campaign_id: int = 1) -> None:
    """The same estimate after each recorded sweep."""
    for sweep in bench.store.sweeps(campaign_id):
        if sweep.state is SweepState.RECORDED:
            bench.store.add_estimate([(sweep, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), document)


async def test_origin_drives_and_one_sweep_come_from_what_was_recorded(bench: Bench, robot: Robot) -> None:
    with pytest.raises(NotFound, match="campaign 99 does not exist"):
        reporting(bench).job(99, "html")
    with pytest.raises(Conflict, match=r"campaign 1 \(planned\) has no identified sweep yet"):
        reporting(bench).job(1, "html")
    await bench.start()
    await bench.over()
    bundle = campaign_bundle(bench.store, bench.files, 1)
    document = estimate_document(robot, [spectrum(robot, sweep) for sweep in bundle.sweeps]).as_json()
    identify(bench, document)
    diagnoses = DiagnosisStore(bench.database)
    for joint in ("joint_1", "joint_2"):
        number = diagnoses.add(NewDiagnosis(robot_id=1, campaigns=(1,), axes=(joint,))).id
        diagnoses.finish(number, diagnosis_document())
    diagnoses.add(NewDiagnosis(robot_id=1, campaigns=(1,), axes=("joint_3",)))  # waits

    job = reporting(bench).job(1, "html")
    assert [(one.joint, one.address, one.serial, one.sweeps) for one in job.report.drives] == [
        (f"joint_{n}", f"node {n}", n, len(POSES)) for n in (1, 2, 3)
    ]
    assert [spec.id for spec in job.specs] == ["0001", "0002", "0003", "0004"]
    assert job.report.diagnosis == (2, diagnosis())
    assert job.report.check is None
    origin = dict(job.report.origin)
    assert origin["robot"] == "max100-class, number 1 of this service"
    assert origin["cell and machine"] == "cell not recorded, machine machine"
    assert origin["ordered by"] == "not recorded"
    assert origin["newest diagnosis"].startswith("number 2, of campaign 1, 20")
    assert origin["recordings"].startswith("4, SHA-256 ")
    parameters: Any = document["base_parameters"]
    names = [one["name"] for one in parameters]
    assert [number for number, _ in job.revisions] == [1, 2, 3, 4]
    assert all([one["name"] for one in found] == names for _, found in job.revisions)  # pyright: ignore[reportOptionalIterable, reportGeneralTypeIssues]  # JSON
    page = job()
    assert isinstance(page, str)
    assert page.startswith("<!doctype html>")

    path = bench.files.path(bench.store.recording(1, 1))
    path.with_suffix(".json").unlink()
    assert [one.sweeps for one in reporting(bench).job(1, "html").report.drives] == [3, 3, 3]


async def test_who_approved_an_experiment_and_its_test_mass_are_told(bench: Bench, robot: Robot) -> None:
    diagnoses = DiagnosisStore(bench.database)
    number = diagnoses.add(NewDiagnosis(robot_id=1, campaigns=(1,), axes=("joint_1",))).id
    diagnoses.finish(number, diagnosis_document())
    mass = BoltedMass(mass=20.0, center=(0.0, 0.0, 0.1))
    new = [NewSweep(spec=spec(1, POSES[0]), mode=None)]
    campaign = diagnoses.approve(number, "joint_1", "Ada", mass, {}, new)
    bench.store.begin_sweep(campaign.id, 1, sweep_move(SweepEvent.BEGIN))
    bench.store.end_sweep(campaign.id, 1, sweep_move(SweepEvent.RECORD))
    identify(bench, stored("estimate-free-motion"), campaign.id)
    job = reporting(bench).job(campaign.id, "html")
    assert dict(job.report.origin)["ordered by"] == "Ada, who approved it as the experiment of a diagnosis"
    assert (job.report.test_mass, job.report.drives, job.example) == (20.0, (), None)


async def test_an_estimate_that_tells_nothing_is_refused(bench: Bench) -> None:
    bench.store.begin_sweep(1, 1, sweep_move(SweepEvent.BEGIN))
    bench.store.end_sweep(1, 1, sweep_move(SweepEvent.RECORD))
    identify(bench, {"axes": {}, "analysis": {}, "combination": None})
    with pytest.raises(Conflict, match="none of its identified sweeps shows an inertia, there is nothing to report"):
        reporting(bench).job(1, "html")


def test_the_revisions_that_are_drawn_are_few_and_end_with_the_last() -> None:
    assert list(spread(3)) == [1, 2, 3]
    for last in (CONVERGENCE, CONVERGENCE + 1, 900):
        drawn = spread(last)
        assert (drawn[0], drawn[-1], len(drawn)) == (1, last, CONVERGENCE)
