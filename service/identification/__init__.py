"""The mathematics of sweepid: pure functions from samples to an estimate; no clock, no files, no logs.

`spectrum(robot, sweep)` computes the spectrum of one sweep from its samples, `identify(robot, spectra)` computes an
estimate from any set of spectra, and `as_document` converts it to JSON data. All are deterministic. A spectrum is
stored in JSON without loss (`Spectrum.to_document`).
"""

from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import Estimate, identify
from service.identification.spectra.frequency_response import Spectrum, spectrum

__all__ = ["Estimate", "Spectrum", "as_document", "identify", "spectrum"]
