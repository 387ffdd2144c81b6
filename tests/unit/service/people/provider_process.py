"""`oidc-provider-mock` as a process, with what a bad provider would send on demand: ``python provider_process.py``.

Prints its issuer. Who logs in decides what becomes of the ID token, by the claim `twist`; every other token passes
as it is, signed by the provider's own key. A twisted one is signed by a second key, which the JWK set then names.
PKCE, of which that provider knows nothing, is checked in front of it.
"""

import base64
import hashlib
import hmac
import io
import json
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any
from urllib.parse import parse_qs, urlsplit
from wsgiref.simple_server import WSGIRequestHandler, make_server

from joserfc import jwt
from joserfc.jwk import RSAKey
from oidc_provider_mock import User, app

Start = Callable[..., Any]

PEOPLE = {
    "olga": {"preferred_username": "olga", "groups": ["staff", "cell-operators"]},
    "otto": {"preferred_username": "otto", "groups": ["staff", "cell-operators"]},
    "adam": {"preferred_username": "adam", "groups": ["cell-operators", "cell-admins"]},
    "nobody": {"preferred_username": "nobody", "groups": ["staff"]},
    "nogroups": {"preferred_username": "nogroups"},
    "one": {"preferred_username": "one", "groups": "cell-operators"},
    "twin": {"preferred_username": "person-operator", "groups": ["cell-operators"]},
    "odd": {"preferred_username": "local", "groups": ["cell-operators"]},
    **{
        twist: {"preferred_username": twist, "groups": ["cell-admins"], "twist": twist}
        for twist in ("expired", "unsigned", "audience", "issuer", "nonce", "shared", "stranger", "azp", "future")
    },
}
KEY = RSAKey.generate_key(2048, {"kid": "second"})
STRANGER = RSAKey.generate_key(2048, {"kid": "second"})


def _b64(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def twisted(token: str) -> str:
    claims = json.loads(base64.urlsafe_b64decode(token.split(".")[1] + "=="))
    twist = claims.pop("twist", "")
    now = int(time.time())
    changes: dict[str, dict[str, Any]] = {
        "expired": {"iat": now - 7200, "exp": now - 3600},
        "audience": {"aud": "another-client"},
        "azp": {"aud": "another-client", "azp": "sweepid"},
        "issuer": {"iss": "https://elsewhere.example"},
        "nonce": {"nonce": "of another login"},
        "future": {"nbf": now + 3600},
    }
    claims |= changes.get(twist, {})
    if twist == "unsigned":
        return f"{_b64(json.dumps({'alg': 'none'}).encode())}.{_b64(json.dumps(claims).encode())}."
    if twist == "shared":  # HS256 with the public key for its secret
        signed = ".".join(_b64(json.dumps(part).encode()) for part in ({"alg": "HS256", "kid": "second"}, claims))
        return f"{signed}.{_b64(hmac.digest(KEY.as_pem(private=False), signed.encode(), 'sha256'))}"
    if twist:
        return jwt.encode({"alg": "RS256", "kid": "second"}, claims, STRANGER if twist == "stranger" else KEY)
    return token


class Provider:
    """The provider's application, and what stands in front of it."""

    def __init__(self) -> None:
        self.app = app(user_claims=[User(sub=sub, claims=claims) for sub, claims in PEOPLE.items()], require_nonce=True)
        self.challenges: dict[str, str] = {}
        self.twisted = False

    def __call__(self, environ: dict[str, Any], start: Start) -> Iterable[bytes]:
        path, asked = environ["PATH_INFO"], b""
        if path == "/oauth2/token":
            asked = environ["wsgi.input"].read(int(environ["CONTENT_LENGTH"]))
            form = parse_qs(asked.decode())
            digest = hashlib.sha256(form["code_verifier"][0].encode()).digest()
            if self.challenges.get(form["code"][0], _b64(digest)) != _b64(digest):
                start("400 Bad Request", [("Content-Type", "application/json")])
                return [b'{"error": "invalid_grant"}']
            environ["wsgi.input"] = io.BytesIO(asked)
        told: list[Any] = []

        def begun(status: str, headers: list[tuple[str, str]], *_: object) -> Callable[[bytes], None]:
            told.extend((status, headers))
            return lambda _: None

        body = b"".join(self.app(environ, begun))
        status, headers = told[0], dict(told[1])
        if path == "/oauth2/authorize" and "Location" in headers:
            query = parse_qs(environ["QUERY_STRING"])
            assert query["code_challenge_method"] == ["S256"]
            self.challenges[parse_qs(urlsplit(headers["Location"]).query)["code"][0]] = query["code_challenge"][0]
        if path == "/oauth2/token" and status.startswith("200"):
            tokens = json.loads(body)
            sent = twisted(tokens["id_token"])
            self.twisted = sent != tokens["id_token"]
            body = json.dumps({**tokens, "id_token": sent}).encode()
        if path == "/jwks" and self.twisted:
            body = json.dumps({"keys": [KEY.as_dict(private=False)]}).encode()
        headers["Content-Length"] = str(len(body))
        start(status, list(headers.items()))
        return [body]


class Quiet(WSGIRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Nothing on stderr."""


if __name__ == "__main__":
    with make_server("127.0.0.1", 0, Provider(), handler_class=Quiet) as server:
        sys.stdout.write(f"http://127.0.0.1:{server.server_port}\n")
        sys.stdout.flush()
        server.serve_forever()
