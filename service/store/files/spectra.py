"""Spectra of identified sweeps as files next to their recordings, named by their content.

A spectrum is written once, when its sweep is identified; every later estimate of the campaign reads it.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from service.model.errors import BadInput
from service.model.results.spectrum import AnySpectrum


@dataclass(frozen=True, slots=True)
class SpectrumFile:
    """Path of a spectrum document, and the SHA-256 of the file."""

    path: Path
    sha256: str


def encode_spectrum(document: AnySpectrum) -> tuple[bytes, str]:
    """The content of a spectrum's file and its SHA-256. Floats are stored without loss."""
    content = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    return content, hashlib.sha256(content).hexdigest()


def read_spectrum(file: SpectrumFile) -> AnySpectrum:
    """The document. Raises BadInput if the file is missing or was changed."""
    try:
        content = file.path.read_bytes()
    except FileNotFoundError:
        raise BadInput(str(file.path), "spectrum file is missing") from None
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise BadInput(str(file.path), f"spectrum file was changed, SHA-256 is not {file.sha256}")
    return json.loads(content)
