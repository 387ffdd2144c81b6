"""One trace leads from the request that starts a campaign to the estimate that its sweeps became."""

from pathlib import Path

import httpx
import pytest

from service.client import ServiceClient
from tests.otlp_collector import Collector, Received, collecting
from tests.system.rest_bench import PATIENT_LEASE, add_plan, serving, until, virtual_machine

pytestmark = pytest.mark.slow

CALLER = "0af7651916cd43dd8448eb211c80319c"  # a trace of the client's own


def test_from_request_to_estimate(tmp_path: Path) -> None:
    with (
        collecting() as collector,
        virtual_machine(tmp_path) as machine,
        serving(
            tmp_path,
            machine.profile,
            PATIENT_LEASE,
            machine_name="cell 7",
            otel={"endpoint": collector.endpoint},
        ) as service,
        ServiceClient(service.url) as client,
    ):
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=1))["id"])
        headers = {"traceparent": f"00-{CALLER}-b7ad6b7169203331-01"}
        url = f"{service.url}/api/v1/campaigns/{campaign}/start"
        httpx.post(url, headers=headers, timeout=60, trust_env=False).raise_for_status()
        until(lambda: client.campaign(campaign)["state"] == "completed", "the campaign is over")
        until(lambda: len(collector.named("store estimate")) == 2, "the service's spans come")
        until(lambda: len(collector.named("Job")) == 2, "the worker's spans come")
        until(lambda: collector.named("campaign"), "the campaign's span comes")
        check(collector, campaign)


def check(collector: Collector, campaign: int) -> None:
    spans = {span.span: span for span in collector.spans}

    def ancestors(span: Received) -> list[str]:
        found = [span.name]
        while span.parent in spans:
            span = spans[span.parent]
            found.append(span.name)
        return found

    (request,) = collector.named("POST /api/v1/campaigns/{id}/start")
    assert (request.trace, request.parent) == (CALLER, "b7ad6b7169203331")
    assert request.attributes["http.response.status_code"] == 200
    way = ["identification", "sweep", "campaign", request.name]
    for estimate in collector.named("store estimate"):
        assert ancestors(estimate) == ["store estimate", *way]
    for job in collector.named("Job"):
        assert ancestors(job) == ["Job", *way]
        assert (job.part, job.machine) == ("worker", "cell 7")
    for part in ("approach", "record"):
        assert [ancestors(span) for span in collector.named(part)] == [[part, *way[1:]]] * 2
    of_trace = [span for span in spans.values() if span.trace == CALLER]
    assert not any(span.failed for span in of_trace)
    assert [span.attributes["sweepid.sweep"] for span in collector.named("sweep")] == [1, 2]
    assert all(span.attributes["sweepid.campaign"] == campaign for span in collector.named("identification"))
    for sweep in collector.named("sweep"):
        inside = [span for span in of_trace if span.parent == sweep.span and span.name in ("approach", "record")]
        assert all(sweep.begin <= span.begin <= span.end <= sweep.end for span in inside)
    assert not [span for span in spans.values() if span.name.startswith("GET")]
