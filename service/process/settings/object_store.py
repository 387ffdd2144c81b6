"""Destination of recordings after their sweep: a shared folder, or a bucket of an S3-compatible store. Pure."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal
from urllib.parse import urlsplit

from service.model.errors import BadInput

_SETTING = "recordings_url"


@dataclass(frozen=True, slots=True)
class StoreAddress:
    """Address without any secret: jobs carry it to workers, which read the key file (or their environment)."""

    protocol: Literal["file", "s3"]
    root: str  # absolute path, or bucket/prefix
    endpoint: str | None = None  # None: Amazon's
    key_file: Path | None = None  # None: the rules of AWS's own programs
    wait: float = 60.0  # s, longest wait for an answer

    def key(self, sha256: str) -> str:
        """The name of a recording's object below `root`; it depends only on the content."""
        return f"{self.root}/{sha256[:2]}/{sha256}.parquet"

    def shown(self, sha256: str) -> str:
        """The address of the object for display."""
        return f"{self.protocol}://{self.key(sha256)}"


def store_address(url: str, endpoint: str | None, key_file: Path | None, wait: float) -> StoreAddress:
    """BadInput for a URL that names neither a folder nor a bucket."""
    parts = urlsplit(url)
    if parts.username is not None or parts.password is not None or parts.query or parts.fragment:
        reason = "must contain only bucket and folder; a key belongs in `recordings_key_file` or the environment"
        raise BadInput(_SETTING, reason)
    path = str(PurePosixPath(parts.path or "/"))
    if ".." in PurePosixPath(path).parts:
        raise BadInput(_SETTING, f"{url} has .. in it")
    if parts.scheme == "file" and not parts.netloc and len(path) > 1:
        if endpoint is not None or key_file is not None:
            raise BadInput(_SETTING, f"{url} is a folder, which has neither endpoint nor key file")
        return StoreAddress("file", path, wait=wait)
    if parts.scheme == "s3" and parts.netloc:
        root = (parts.netloc + path).rstrip("/")
        return StoreAddress("s3", root, endpoint, None if key_file is None else key_file.absolute(), wait)
    raise BadInput(_SETTING, f"{url} is neither s3://BUCKET/PREFIX nor file:///FOLDER")
