"""The mathematics of sweepid: pure functions from samples to an estimate; no clock, no files, no logs.

`spectra.frequency_response.spectrum` computes the spectrum of one sweep from its samples, `estimates.estimate.identify`
an estimate from any set of spectra, and `estimates.document.as_document` converts it to JSON data. All are
deterministic. A spectrum is stored in JSON without loss (`Spectrum.to_document`).
"""
