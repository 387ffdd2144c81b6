"""The connection of the client to a service: requests and errors. Blocking."""

import os
import ssl
import uuid
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any, cast

import httpx

from service.model.errors import BadInput, ServiceProblem, ServiceUnreachable

Json = dict[str, Any]

LONG_TIMEOUT = httpx.Timeout(600.0, connect=5.0)  # planning many poses, large bundles
_TIMEOUT = httpx.Timeout(30.0, connect=5.0)
_BAD_INPUT = 422  # HTTP status
_SILENCE = 40.0  # s; an idle event stream carries a comment every 15 s


class Connection:
    """One connection pool; errors as in `ServiceClient`."""

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

    @contextmanager
    def _stream(self, campaign_id: int | None, after: int) -> Generator[Iterator[str]]:
        timeout = httpx.Timeout(_SILENCE, connect=5.0)
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
        response = self._send("POST", path, json=body, headers={"Idempotency-Key": str(uuid.uuid4())}, timeout=timeout)
        check(response)
        return cast("Json", response.json())

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
    if response.status_code == _BAD_INPUT:
        first = next(iter(problem.get("errors", ())), {"pointer": response.url.path, "reason": problem["detail"]})
        raise BadInput(first["pointer"], first["reason"])
    raise ServiceProblem(response.status_code, problem["detail"])
