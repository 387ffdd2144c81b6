"""Recordings in a shared folder or an S3-compatible store, through fsspec, which is imported when needed.

Objects are named by the SHA-256 of their content: every writer writes the same content, and an object whose content
does not match its name is useless, so that writing it again repairs it. An object is always complete: S3 guarantees
that, and in a folder a finished file is renamed.
"""

import configparser
import hashlib
import tempfile
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, cast
from uuid import uuid4

from service import BadInput, NotNow
from service.model import Recording
from service.process.settings import StoreAddress
from service.store.files.columns import read_columns
from service.store.files.recordings import RecordingFile, RecordingFiles, check_file, place, place_new, still_here, sync


class StoreAway(NotNow):
    """The store does not answer, or refuses the login: the request may be repeated."""


class MissingObject(BadInput):
    """The store answers and does not have the object."""


class WrongObject(BadInput):
    """The content of an object does not match its name."""


class ObjectStore:
    """Methods block. All raise StoreAway; BadInput if the extra is not installed or a key cannot be read."""

    def __init__(self, address: StoreAddress) -> None:
        self._address = address
        self._files, self._troubles = _opened(address)

    def put(self, path: Path, sha256: str) -> None:
        """Write a file to the store and read all of it back; an existing object is only read.

        Raises BadInput if the file is not the recorded one, WrongObject if the content read back differs.
        """
        if not path.exists():  # moved and removed, which is missing in a database from a backup
            with suppress(MissingObject):
                return self.check(sha256)
        check_file(path, sha256)
        size = path.stat().st_size
        try:
            self.check(sha256, size)
        except (MissingObject, WrongObject):
            self._write(path, sha256)
            self.check(sha256, size)

    def check(self, sha256: str, size: int | None = None) -> None:
        """Read an object completely. Raises MissingObject or WrongObject if it is missing or was changed."""
        shown = self._address.shown(sha256)
        digest, count = hashlib.sha256(), 0
        for chunk in self._chunks(sha256):
            digest.update(chunk)
            count += len(chunk)
        if size is not None and count != size:
            raise WrongObject(shown, f"has {count} bytes instead of {size}")
        _check_digest(digest.hexdigest(), sha256, shown)

    def fetch(self, sha256: str, target: Path) -> None:
        """Write an object to a new file, synced. Errors as `check`; then no file is left."""
        digest = hashlib.sha256()
        try:
            with target.open("xb") as file:
                for chunk in self._chunks(sha256):
                    digest.update(chunk)
                    file.write(chunk)
            _check_digest(digest.hexdigest(), sha256, self._address.shown(sha256))
            sync(target)
        except BaseException:
            target.unlink(missing_ok=True)
            raise

    def remove(self, sha256: str) -> None:
        """No effect if the object does not exist. Raises StoreAway."""
        self._check_root()
        with self._asked(), suppress(FileNotFoundError):
            self._files.rm_file(self._address.key(sha256))

    def _chunks(self, sha256: str) -> Iterator[bytes]:
        """Content of an object; errors of the consumer pass unchanged."""
        self._check_root()
        with self._asked():
            try:
                file = cast(BinaryIO, self._files.open(self._address.key(sha256), "rb", **self._reading))
            except FileNotFoundError:
                raise MissingObject(self._address.shown(sha256), "object is missing") from None
        with file:
            while True:
                with self._asked():
                    chunk = file.read(2**20)
                if not chunk:
                    return
                yield chunk

    @property
    def _reading(self) -> dict[str, Any]:
        return {"cache_type": "readahead", "block_size": 2**23} if self._address.protocol == "s3" else {}

    def _write(self, path: Path, sha256: str) -> None:
        key = self._address.key(sha256)
        with self._asked():
            if self._address.protocol == "s3":
                self._upload(path, key)
                return
            target = Path(key)
            target.parent.mkdir(exist_ok=True)
            partial = target.with_name(f".{target.name}.{uuid4().hex}.partial")
            try:
                self._files.put_file(str(path), str(partial))
                place(partial, target)
            finally:
                partial.unlink(missing_ok=True)

    def _upload(self, path: Path, key: str) -> None:
        """With a time limit: an upload to a host that accepts no data would wait forever."""
        from fsspec import asyn

        longest = self._address.wait + path.stat().st_size / 1e5  # bytes/s of an upload; a slower one is aborted
        cast(Any, asyn).sync(self._files.loop, self._files._put_file, str(path), key, timeout=longest)

    def _check_root(self) -> None:
        """A folder must exist: if a share is not mounted, its path would fill the disk of this computer."""
        if self._address.protocol == "file" and not Path(self._address.root).is_dir():
            raise StoreAway(f"file://{self._address.root} does not exist: create the folder, or mount its share")

    @contextmanager
    def _asked(self) -> Generator[None]:
        try:
            yield
        except (NotNow, BadInput):
            raise
        except self._troubles as error:
            said = " ".join(str(error).split()) or type(error).__name__
            raise StoreAway(f"{self._address.protocol}://{self._address.root}: {said}") from None


def check_usable(address: StoreAddress) -> None:
    """Raises BadInput if the extra is not installed or the key file cannot be read; the store is not contacted."""
    for name in ("fsspec",) if address.protocol == "file" else ("fsspec", "s3fs"):
        if find_spec(name) is None:
            raise _not_installed(name)
    _keys(address.key_file)


def _not_installed(name: str | None) -> BadInput:
    return BadInput("recordings_url", f"needs {name}: install sweepid with its extra, `sweepid[s3]`")


def _check_digest(found: str, sha256: str, shown: str) -> None:
    if found != sha256:
        raise WrongObject(shown, f"object was changed, SHA-256 is not {sha256}")


def _opened(address: StoreAddress) -> tuple[Any, tuple[type[Exception], ...]]:
    """fsspec's file system, which is untyped, and its errors for an unavailable store."""
    try:
        if address.protocol == "file":
            from fsspec.implementations.local import LocalFileSystem

            return cast(Any, LocalFileSystem)(skip_instance_cache=True), (OSError,)
        import aiohttp
        import botocore.exceptions as botocore
        import s3fs
    except ModuleNotFoundError as error:
        raise _not_installed(error.name) from None
    options: dict[str, Any] = {
        "connect_timeout": min(5.0, address.wait),  # s
        "read_timeout": address.wait,
        "retries": {"total_max_attempts": 1},  # s3fs repeats attempts itself
        # not every store supports AWS's newer checksums; SHA-256 is compared here in any case
        "request_checksum_calculation": "when_required",
        "response_checksum_validation": "when_required",
    }
    if address.endpoint is not None:
        options["s3"] = {"addressing_style": "path"}  # there, buckets have no host names of their own
    files = cast(Any, s3fs).S3FileSystem(
        endpoint_url=address.endpoint, config_kwargs=options, use_listings_cache=False, **_keys(address.key_file)
    )
    errors = cast(Any, botocore)
    return files, (OSError, errors.BotoCoreError, errors.ClientError, aiohttp.ClientError)


def _keys(file: Path | None) -> dict[str, str]:
    """Section `default` of a file in the AWS format; errors never contain its content."""
    if file is None:
        return {}
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(file.read_text(encoding="utf-8"))
        section = parser["default"]
        keys = {"key": section["aws_access_key_id"], "secret": section["aws_secret_access_key"]}
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise BadInput("recordings_key_file", f"{file} cannot be read: {reason}") from None
    except (configparser.Error, KeyError):
        wanted = "[default] with aws_access_key_id and aws_secret_access_key"
        raise BadInput("recordings_key_file", f"{file} does not have {wanted}") from None
    token = section.get("aws_session_token")
    return keys if token is None else {**keys, "token": token}


def read_recording(file: RecordingFile) -> Recording:
    """Samples of a recording. BadInput if it is missing or was changed, StoreAway while the store does not answer."""
    if file.store is None:
        return read_columns(file.path)
    if still_here(file.path):
        check_file(file.path, file.sha256)
        return read_columns(file.path)
    if file.transfer.is_dir():
        bring(file)
        return read_columns(file.path)
    with tempfile.TemporaryDirectory(prefix="sweepid-") as name:  # a worker on another computer
        path = Path(name) / file.path.name
        _fetch(file, path)
        return read_columns(path)


def bring(file: RecordingFile) -> None:
    """Fetch a recording from the store to its path; no effect if it exists. Errors as `read_recording`."""
    partial = file.transfer / f"{RecordingFiles.fetched}{uuid4().hex}"
    _fetch(file, partial)
    try:
        file.path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            place_new(partial, file.path)
    finally:
        partial.unlink(missing_ok=True)


def _fetch(file: RecordingFile, target: Path) -> None:
    if file.store is None:
        raise BadInput(str(file.path), "recording file is missing")
    try:
        ObjectStore(file.store).fetch(file.sha256, target)
    except MissingObject as error:
        if file.was_here:  # not moved yet, and this worker has no access to the service's data folder
            raise StoreAway(f"{error}: the service has not moved it yet") from None
        raise BadInput(str(file.path), f"recording file is missing, and {error.place}: {error.reason}") from None
