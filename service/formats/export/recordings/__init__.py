"""Recordings in the formats of other tools: MDF4, HDF5, MCAP and CSV. One module per format, and `metadata` for all."""

from service.formats.export.recordings.writing import FORMATS, write_recordings

__all__ = ["FORMATS", "write_recordings"]
