"""What Prometheus gets, read by its own parser: every figure of the reference page, with the values of the estimate."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.web.api.metrics import GROUPS, page
from service.web.client import ServiceClient
from tests.unit.service.api.conftest import opened

pytestmark = pytest.mark.slow

Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]
FIGURES = {figure.name: figure for figures in GROUPS.values() for figure in figures}
STREAMED = {"sweepid_set_points", "sweepid_set_points_missed", "sweepid_set_point_lateness_seconds"}
MOVED = {name for name, figure in FIGURES.items() if figure.absent}  # not in this installation


def scraped(text: str) -> Samples:
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def of(samples: Samples, name: str, **labels: str) -> float:
    return samples[name, frozenset(labels.items())]


def test_the_figures_are_those_of_the_latest_estimate(url: str, campaign: int) -> None:
    with ServiceClient(url) as client:
        estimate = client.estimate(campaign)
    samples = scraped(httpx.get(f"{url}/metrics", timeout=30, trust_env=False).text)
    axis = estimate["document"]["axes"]["joint_1"]
    robot = "max100-class"
    assert of(samples, "sweepid_estimate_sweeps", robot=robot, axis="joint_1") == len(axis["inertia"]) == 3
    gap, left = (axis["rmse_percent"][name] / 100 for name in ("reference_measured", "identified_measured"))
    assert of(samples, "sweepid_estimate_gap_ratio", robot=robot, axis="joint_1") == pytest.approx(gap)
    assert of(samples, "sweepid_estimate_left_ratio", robot=robot, axis="joint_1") == pytest.approx(left)
    assert of(samples, "sweepid_estimate_revision", robot=robot) == estimate["revision"]
    assert of(samples, "sweepid_recordings", state="complete") >= 3
    assert of(samples, "sweepid_recorded_samples", state="complete") >= 3 * 1250
    own = {"machine": "machine"}
    assert of(samples, "sweepid_machine_connected", **own) == of(samples, "sweepid_machine_may_move", **own) == 0
    assert of(samples, "sweepid_campaigns", machine="machine", state="completed") >= 1


@pytest.mark.usefixtures("campaign")
def test_every_figure_has_its_help_and_no_other_comes(url: str) -> None:
    text = httpx.get(f"{url}/metrics", timeout=30, trust_env=False).text
    shown = {family.name: family.documentation for family in text_string_to_metric_families(text)}
    assert shown == {name: figure.help for name, figure in FIGURES.items() if name not in STREAMED | MOVED}


def test_names_are_those_that_prometheus_asks_for() -> None:
    assert [name for name in FIGURES if not re.fullmatch(r"sweepid_[a-z_]+[a-z]", name)] == []
    assert [name for name in FIGURES if name.endswith(("_total", "_percent", "_ms", "_min"))] == []


async def test_a_database_that_refuses_takes_only_its_own_figures_away(tmp_path: Path, profile: Path) -> None:
    async with opened(tmp_path, profile) as (_, http):
        with closing(sqlite3.connect(tmp_path / "sweepid.sqlite", timeout=30)) as other:
            other.execute("ALTER TABLE recording RENAME TO elsewhere")
            answer = await http.get("http://127.0.0.1/metrics")
            other.execute("ALTER TABLE elsewhere RENAME TO recording")
    samples = scraped(answer.raise_for_status().text)
    assert of(samples, "sweepid_stop_latched", machine="machine") == 0
    assert of(samples, "sweepid_jobs_open", machine="machine", kind="identification") == 0
    assert "sweepid_estimate_revision" not in {name for name, _ in samples}


def test_the_page_is_fresh(root: Path) -> None:
    told = "run: python -m service.web.api.metrics > docs/reference/metrics.md"
    assert (root / "docs" / "reference" / "metrics.md").read_text("utf-8") == page(), told
