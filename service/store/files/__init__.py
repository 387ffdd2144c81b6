"""Recordings, spectra and bundles in the data folder."""
