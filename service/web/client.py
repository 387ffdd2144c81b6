"""A small client of the service's REST API, for the command line and the demo. Blocking; one connection pool."""

import json
import os
import ssl
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlencode

import httpx

from service import BadInput, ServiceProblem, ServiceUnreachable

Json = dict[str, Any]

LONG_TIMEOUT = httpx.Timeout(600.0, connect=5.0)  # planning many poses, large bundles
_TIMEOUT = httpx.Timeout(30.0, connect=5.0)

__all__ = ["HOST_WATCH", "Json", "ServiceClient", "ServiceProblem", "ServiceUnreachable"]

HOST_WATCH = "host watch"  # `by` of a stop that no person pressed

_STOP_TIMEOUT = httpx.Timeout(2.0)  # a stop is answered within 1.2 s


class ServiceClient(AbstractContextManager["ServiceClient"]):
    """Every method raises `ServiceUnreachable`, `ServiceProblem` or, for rejected input (422), `BadInput`.

    Each command has its own idempotency key. Documents are returned as received from the API.
    """

    _stop_url = ""  # of the stop process, once it is known

    def __init__(self, url: str, key: str | None = None) -> None:
        """`key`: for a service with login; None: that of the environment, SWEEPID_KEY."""
        key = os.environ.get("SWEEPID_KEY", "").strip() if key is None else key
        self._url = url
        # the certificates of this computer, or those of SSL_CERT_FILE
        self._tls = ssl.create_default_context() if url.startswith("https:") else True
        self._http = httpx.Client(
            base_url=f"{url.rstrip('/')}/api/v1",
            timeout=_TIMEOUT,
            trust_env=False,
            verify=self._tls,
            headers={"Authorization": f"Bearer {key}"} if key else None,
        )

    def __exit__(self, *_: object) -> None:
        self._http.close()

    # -- robots and plans
    def add_robot(self, description: Json, urdf_text: str) -> Json:
        return self._post("/robots", {"description": description, "urdf_text": urdf_text})

    def robots(self) -> list[Json]:
        """All robots, without their URDF."""
        return self._all("/robots")

    def robot(self, robot_id: int) -> Json:
        """One robot, with its URDF."""
        return self._get(f"/robots/{robot_id}")

    def cells(self) -> list[str]:
        """Names of the cells of the service."""
        return list(self._get("/cells")["names"])

    def machines(self) -> Json:
        """The machines of the plant (`items`), with robot and cell; `here`: that of this service."""
        return self._get("/machines")

    def add_plan(
        self,
        request: Json,
        *,
        elsewhere: bool = False,
        confirm_robot: str | None = None,
        confirm_cell: str | None = None,
    ) -> Json:
        """`elsewhere`: for another machine than that of the service. `confirm_robot`, `confirm_cell`: as typed by a
        person, names that are not the machine's.
        """
        path = f"/plans{_query(confirm_robot, confirm_cell, elsewhere='true' if elsewhere else None)}"
        return self._post(path, request, timeout=LONG_TIMEOUT)

    def plan(self, plan_id: int) -> Json:
        return self._get(f"/plans/{plan_id}")

    def approvals(self, plan_id: int) -> Json:
        """`needed`, `missing`, `sha256` of the present motion of the plan, and its approvals (`items`)."""
        return self._get(f"/plans/{plan_id}/approvals")

    def approve(self, plan_id: int, sha256: str, approved_by: str | None = None) -> Json:
        """Approve the motion with this hash. `approved_by`: name, required without login."""
        return self._post(f"/plans/{plan_id}/approvals", {"sha256": sha256, "approved_by": approved_by})

    # -- campaigns
    def add_campaign(self, plan_id: int) -> Json:
        return self._post("/campaigns", {"plan_id": plan_id})

    def campaigns(self) -> list[Json]:
        """All campaigns, oldest first."""
        return self._all("/campaigns")

    def campaign(self, campaign_id: int) -> Json:
        return self._get(f"/campaigns/{campaign_id}")

    def ahead(self, campaign_id: int, repeat: bool = False) -> Json:
        """What a start or resume will move now: robot, cell, machine, approach, range of each axis."""
        return self._get(f"/campaigns/{campaign_id}/ahead{'?repeat=true' * repeat}")

    def plan_ahead(self, plan_id: int) -> Json:
        """As `ahead`, for all sweeps of a plan."""
        return self._get(f"/plans/{plan_id}/ahead")

    def start(self, campaign_id: int, attended: float | None = None, seen: Json | None = None) -> Json:
        """Connects the drives first if necessary. Reads the address of the stop before, while the service answers.

        `attended`: s between two calls of `sign_of_life`; after a longer time the campaign is paused. `seen`: `range`
        of `ahead` that was shown; refused if an axis has left it.
        """
        self._find_stop()
        wanted = _attended(attended) | ({} if seen is None else {"seen": seen})
        return self._post(f"/campaigns/{campaign_id}/start", wanted, timeout=LONG_TIMEOUT)

    def sign_of_life(self, campaign_id: int) -> Json | None:
        """Send a sign of life; None if the campaign requires none."""
        return cast("Json | None", check(self._send("POST", f"/campaigns/{campaign_id}/sign_of_life")).json())

    def pause(self, campaign_id: int) -> Json:
        return self._post(f"/campaigns/{campaign_id}/pause")

    def resume(
        self, campaign_id: int, repeat: bool = False, attended: float | None = None, seen: Json | None = None
    ) -> Json:
        """`attended`, `seen` as in `start`."""
        self._find_stop()
        return self._post(f"/campaigns/{campaign_id}/resume", {"repeat": repeat, "seen": seen, **_attended(attended)})

    def abort(self, campaign_id: int, why: str) -> Json:
        return self._post(f"/campaigns/{campaign_id}/abort", {"why": why})

    def sweeps(self, campaign_id: int) -> list[Json]:
        return cast("list[Json]", self._get(f"/campaigns/{campaign_id}/sweeps"))

    def estimates(self, campaign_id: int) -> list[Json]:
        """All revisions, oldest first."""
        return self._all(f"/campaigns/{campaign_id}/estimates")

    def estimate(self, campaign_id: int) -> Json:
        """The latest revision."""
        return self._get(f"/campaigns/{campaign_id}/estimates/latest")

    def campaign_report(self, campaign_id: int, ending: str = "html") -> bytes:
        """One page, as `html` or `pdf`; its tables as `json`."""
        return self._file(f"/campaigns/{campaign_id}/report{'' if ending == 'html' else f'.{ending}'}")

    # -- diagnoses
    def add_diagnosis(
        self,
        campaigns: Sequence[int],
        axes: Sequence[str] | None = None,
        model: int | None = None,
        unattended: bool = False,
        start: str = "estimate",
    ) -> Json:
        """Returns at once; `diagnosed` waits for the end."""
        wanted = {"campaigns": campaigns, "axes": axes, "model": model, "start": start, "unattended": unattended}
        return self._post("/diagnoses", wanted)

    def diagnoses(self) -> list[Json]:
        """All diagnoses without their documents, oldest first."""
        return self._all("/diagnoses")

    def diagnosis(self, diagnosis_id: int) -> Json:
        return self._get(f"/diagnoses/{diagnosis_id}")

    def diagnosed(self, diagnosis_id: int) -> Json:
        """Wait until the diagnosis is done or failed, and return it."""
        return self._over("diagnosis", diagnosis_id, self.diagnosis)

    def plan_experiment(
        self,
        diagnosis_id: int,
        axis: str,
        cell: str | None = None,
        *,
        confirm_robot: str | None = None,
        confirm_cell: str | None = None,
    ) -> Json:
        """The plan of an axis's next experiment, stored for reading; names as in `add_plan`."""
        path = f"/diagnoses/{diagnosis_id}/plan{_query(confirm_robot, confirm_cell)}"
        return self._post(path, {"axis": axis, "cell": cell}, timeout=LONG_TIMEOUT)

    def approve_experiment(
        self,
        diagnosis_id: int,
        axis: str,
        approved_by: str,
        test_mass: Json | None = None,
        cell: str | None = None,
        *,
        confirm_robot: str | None = None,
        confirm_cell: str | None = None,
    ) -> Json:
        """Start the next experiment; returns its campaign. The diagnosis continues when that is completed.

        Names as in `add_plan`.
        """
        wanted = {"axis": axis, "approved_by": approved_by, "test_mass": test_mass, "cell": cell}
        path = f"/diagnoses/{diagnosis_id}/experiment{_query(confirm_robot, confirm_cell)}"
        return self._post(path, wanted, timeout=LONG_TIMEOUT)

    def diagnosis_report(self, diagnosis_id: int, ending: str = "html") -> bytes:
        """One page, as `html` or `pdf`; its tables as `json`."""
        return self._file(f"/diagnoses/{diagnosis_id}/report.{ending}")

    def accept_model(self, diagnosis_id: int, accepted_by: str, axes: Sequence[str] | None = None) -> Json:
        """Accept the named effects into the robot's model."""
        return self._post(f"/diagnoses/{diagnosis_id}/model", {"accepted_by": accepted_by, "axes": axes})

    def models(self, robot_id: int | None = None) -> list[Json]:
        """All accepted models, or one robot's, oldest first."""
        return self._all("/models" if robot_id is None else f"/models?robot={robot_id}")

    def model(self, model_id: int) -> Json:
        return self._get(f"/models/{model_id}")

    def model_scenario(self, model_id: int) -> str:
        """The scenario for a virtual machine, YAML."""
        return self._file(f"/models/{model_id}/scenario.yaml").decode()

    def fleet(self, type_name: str | None = None) -> Json:
        """Control charts, outliers and due dates of the robots of one type, or of all types."""
        return self._get(f"/fleet{_of_type(type_name)}")

    def fleet_report(self, type_name: str | None = None, ending: str = "html") -> bytes:
        return self._file(f"/fleet/report{'' if ending == 'html' else f'.{ending}'}{_of_type(type_name)}")

    # -- jobs
    def add_job(self, campaigns: Sequence[int] | None = None) -> Json:
        """Identify these campaigns again, or all of the service's machine; returns at once."""
        return self._post("/jobs", {"campaigns": campaigns or None})

    def jobs(self) -> list[Json]:
        """All jobs, oldest first."""
        return self._all("/jobs")

    def job(self, job_id: int) -> Json:
        return self._get(f"/jobs/{job_id}")

    def job_over(self, job_id: int) -> Json:
        """Wait until the job is done or cancelled, and return it."""
        return self._over("batch", job_id, self.job)

    def job_results(self, job_id: int) -> list[Json]:
        return self._all(f"/jobs/{job_id}/results")

    def cancel_job(self, job_id: int) -> Json:
        return self._post(f"/jobs/{job_id}/cancel")

    # -- payloads
    def payload_over(self, before: int, after: int) -> Json:
        """The payload of campaign `after`, of the plan of `before`, once it is computed."""
        wanted = self._post("/payloads", {"before": before, "after": after})
        return self._over("batch", int(wanted["id"]), self._payload)

    def _payload(self, payload_id: int) -> Json:
        return self._get(f"/payloads/{payload_id}")

    def payload_sheet(self, payload_id: int) -> str:
        """What to enter in the controls, Markdown."""
        return self._file(f"/payloads/{payload_id}/sheet.md").decode()

    # -- the machine
    def ready(self) -> Json:
        """``{"ready", "causes"}``; not ready is a normal answer, no error."""
        response = self._send("GET", "/health/ready")
        if response.status_code not in (200, 503):
            check(response)
        return cast("Json", response.json())

    def version(self) -> str:
        """Version of the service."""
        return str(self._get("/openapi.json")["info"]["version"])

    def drives(self) -> Json:
        return self._get("/drives")

    def connect(self) -> Json:
        """Connect the drives, also after a loss; every axis is disabled afterwards."""
        return self._post("/drives/connect", timeout=LONG_TIMEOUT)

    def acknowledge(self, joint: str) -> Json:
        return self._post(f"/drives/{joint}/acknowledge")

    def stop(self, by: str, why: str) -> Json:
        """Both ways at once, if `start` or `resume` has read the address of the stop process: the service may be busy.

        ServiceProblem names the axes that did not confirm standstill to either; it comes within `_STOP_TIMEOUT`.
        """
        words = {"by": by, "why": why, "press": str(uuid.uuid4())}
        with ThreadPoolExecutor(1, thread_name_prefix="stop") as beside:
            other = beside.submit(self._stop_beside, words) if self._stop_url else None
            try:
                return cast("Json", check(self._send("POST", "/stop", params=words, timeout=_STOP_TIMEOUT)).json())
            except (ServiceProblem, ServiceUnreachable):
                if other is None or (answer := other.result()) is None:
                    raise
                return cast("Json", check(answer).json())

    def _stop_beside(self, words: dict[str, str]) -> httpx.Response | None:
        with suppress(httpx.TransportError):
            return httpx.post(self._stop_url, params=words, timeout=_STOP_TIMEOUT, trust_env=False, verify=self._tls)

    def stops(self) -> list[Json]:
        """The stops that hold the machine, oldest first."""
        return cast("list[Json]", self._get("/stop")["stops"])

    def reset_stop(self, by: str, stops: Sequence[int]) -> Json:
        """Release these stops."""
        return self._post("/stop/reset", {"by": by, "stops": list(stops)})

    def _over(self, kind: str, number: int, read: Callable[[int], Json]) -> Json:
        """Wait until `read` returns a finished object, which events of this kind report, and return it."""
        found = read(number)
        open_states = ("waiting", "running")
        if found["state"] in open_states:
            for event in self.events(after=0):
                if event["kind"] == kind and event["data"][kind] == number:
                    found = read(number)
                    if found["state"] not in open_states:
                        break
        return found

    def _find_stop(self) -> None:
        with suppress(ServiceUnreachable, ServiceProblem):  # the following code reports the error
            port = self._get("/stop")["port"]
            url = self._http.base_url
            self._stop_url = "" if port is None else f"{url.scheme}://{url.host}:{port}/stop"

    # -- bundles
    def import_bundle(self, archive: Path) -> Json:
        """Upload a zip file."""
        headers = {"Content-Type": "application/zip", "Idempotency-Key": str(uuid.uuid4())}
        options = {"content": archive.read_bytes(), "headers": headers, "timeout": LONG_TIMEOUT}
        return cast("Json", check(self._send("POST", "/bundles", **options)).json())

    def export_bundle(self, campaign_id: int, archive: Path) -> None:
        """Download a campaign's bundle as a zip file."""
        try:
            with self._http.stream("GET", f"/campaigns/{campaign_id}/bundle", timeout=LONG_TIMEOUT) as response:
                if response.is_error:
                    response.read()
                    check(response)
                with archive.open("wb") as file:
                    for chunk in response.iter_bytes():
                        file.write(chunk)
        except httpx.TransportError as error:
            raise self._unreachable(error) from None

    # -- events
    def events(self, campaign_id: int | None = None, after: int = 0) -> Iterator[Json]:
        """Events of a campaign (None: all) with an id above `after`, then new ones, without end.

        A lost connection is reopened after the last event received; `ServiceUnreachable` after 20 s without one.
        """
        lost: float | None = None  # time of the loss of the connection
        while True:
            reason = "the event stream ended"
            try:
                with self._stream(campaign_id, after) as lines:
                    for line in lines:
                        lost = None
                        if line.startswith("data:"):
                            event = cast("Json", json.loads(line[5:]))
                            after = int(event["id"])
                            yield event
            except httpx.TransportError as error:
                reason = str(error)
            lost = time.monotonic() if lost is None else lost
            if time.monotonic() - lost > 20.0:  # s
                raise ServiceUnreachable(f"{self._url}: {reason}")
            time.sleep(0.5)  # s

    # -- requests
    @contextmanager
    def _stream(self, campaign_id: int | None, after: int) -> Generator[Iterator[str]]:
        timeout = httpx.Timeout(40.0, connect=5.0)  # an idle event stream carries a comment every 15 s
        query = {"after": after} if campaign_id is None else {"campaign": campaign_id, "after": after}
        with self._http.stream("GET", "/events", params=query, timeout=timeout) as response:
            if response.is_error:
                response.read()
                check(response)
            yield response.iter_lines()

    def _get(self, path: str) -> Json:
        return cast("Json", check(self._send("GET", path)).json())

    def _file(self, path: str) -> bytes:
        """Content that is not a JSON document."""
        return check(self._send("GET", path, timeout=LONG_TIMEOUT)).content

    def _all(self, path: str) -> list[Json]:
        items: list[Json] = []
        after: int | None = 0
        while after is not None:
            page = self._get(f"{path}{'&' if '?' in path else '?'}limit=200&after={after}")
            items += page["items"]
            after = page["next"]
        return items

    def _post(self, path: str, body: Json | None = None, timeout: httpx.Timeout = _TIMEOUT) -> Json:
        headers = {"Idempotency-Key": str(uuid.uuid4())}
        return cast("Json", check(self._send("POST", path, json=body, headers=headers, timeout=timeout)).json())

    def _send(self, method: str, path: str, **options: Any) -> httpx.Response:
        try:
            return self._http.request(method, path, **options)
        except httpx.TransportError as error:
            raise self._unreachable(error) from None

    def _unreachable(self, error: httpx.TransportError) -> ServiceUnreachable:
        if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
            return ServiceUnreachable(
                f"no service at {self._url}: start it with `sweepid serve`, or give its address with "
                "--url or SWEEPID_URL"
            )
        return ServiceUnreachable(f"{self._url}: {error or type(error).__name__}")


def check(response: httpx.Response) -> httpx.Response:
    """The response, if it reports success. Raises ServiceProblem, BadInput."""
    if response.is_success:
        return response
    if not response.headers.get("content-type", "").startswith("application/problem+json"):
        raise ServiceProblem(response.status_code, f"{response.url}: {response.status_code} {response.text[:200]}")
    problem = cast("Json", response.json())
    if response.status_code == HTTPStatus.UNPROCESSABLE_ENTITY:
        first = next(iter(problem.get("errors", ())), {"pointer": response.url.path, "reason": problem["detail"]})
        raise BadInput(first["pointer"], first["reason"])
    raise ServiceProblem(response.status_code, problem["detail"])


def _of_type(name: str | None) -> str:
    return "" if name is None else f"?{httpx.QueryParams(type=name)}"


def _query(confirm_robot: str | None, confirm_cell: str | None, **more: str | None) -> str:
    """The query with what is given; empty if nothing is."""
    given = {"confirm_robot": confirm_robot, "confirm_cell": confirm_cell, **more}
    known = {name: value for name, value in given.items() if value}
    return f"?{urlencode(known)}" if known else ""


def _attended(within: float | None) -> Json:
    return {} if within is None else {"attended": {"within_s": within}}
