"""Where the commands find the service."""

from typing import Annotated

import typer

Url = Annotated[str, typer.Option(envvar="SWEEPID_URL", help="Address of the service.")]
DEFAULT_URL = "http://127.0.0.1:8642"
