"""The settings of a command that works on the data of the service."""

from pathlib import Path

from service.process.settings import Settings, load_settings


def settings_of(config: Path | None, data_dir: Path | None) -> Settings:
    """As `sweepid serve` takes them."""
    return load_settings(config).model_copy(update={} if data_dir is None else {"data_dir": data_dir})
