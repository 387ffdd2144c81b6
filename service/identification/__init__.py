"""The mathematics of sweepid: pure functions from samples to an estimate; no clock, no files, no logs.

`spectrum(robot, sweep)` turns the samples of one sweep into its spectrum, `identify(robot, spectra)` any set of spectra
into an estimate, `as_document` makes JSON-able data of it. All are deterministic; a spectrum survives JSON exactly
(`Spectrum.to_document`).
"""

from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import Estimate, identify
from service.identification.spectra.frequency_response import Spectrum, spectrum

__all__ = ["Estimate", "Spectrum", "as_document", "identify", "spectrum"]
