"""Executes the retention rule: rows first, then files, so that an interrupted run is completed by the next one."""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from service.model.errors import Conflict
from service.store.access.audit_chain import Entry
from service.store.objects.object_store import ObjectStore
from service.store.plant.retention import Doomed, RetentionStore, Rules, Sample


@dataclass(slots=True)
class Pruned:
    """What was, or would be, removed. `bytes`: of files in the data folder. `stay`: why campaigns are kept, by
    number.
    """

    campaigns: int = 0
    recordings: int = 0
    spectra: int = 0
    estimates: int = 0
    bytes: int = 0
    stay: dict[int, str] = field(default_factory=dict[int, str])


def prune(
    store: RetentionStore,
    data_dir: Path,
    objects: ObjectStore | None,
    rules: Rules,
    at: datetime,
    entry: Entry | None,
    tell: Callable[[Doomed], None] = lambda one: None,
) -> Pruned:
    """Remove what the rules name; without an audit `entry` only report what would be removed. Manifests are kept.

    Blocks. Raises NotNow while the object store does not answer: rows marked as removed are then removed by the next
    run.
    """
    doomed, stay = store.doomed(rules, at)
    found = Pruned(stay=stay)
    if entry is not None:
        for sample in store.removed():  # of an interrupted run
            _remove(store, sample, data_dir, objects)
    for one in doomed:
        paths = [data_dir / path for path in (*(sample.path for sample in one.samples), *(p for _, p in one.spectra))]
        size = sum(path.stat().st_size for path in paths if path.exists())
        if entry is not None:
            try:
                store.remove(one, at, entry)
            except Conflict as error:
                found.stay[one.campaign_id] = str(error)
                continue
            for sample in one.samples:
                _remove(store, sample, data_dir, objects)
            for _, path in one.spectra:
                (data_dir / path).unlink(missing_ok=True)
        tell(one)
        found.campaigns += 1
        found.recordings += len(one.samples)
        found.spectra += len(one.spectra)
        found.estimates += len(one.estimates)
        found.bytes += size
    return found


def _remove(store: RetentionStore, sample: Sample, data_dir: Path, objects: ObjectStore | None) -> None:
    """The object is removed with the last recording of its content."""
    (data_dir / sample.path).unlink(missing_ok=True)
    if objects is not None and sample.moved:
        if sample.alone:
            objects.remove(sample.sha256)
        store.object_is_gone(sample)
