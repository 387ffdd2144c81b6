"""One figure of the Prometheus metrics."""

from collections.abc import Mapping
from dataclasses import dataclass

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily


def figures_of(module: Mapping[str, object]) -> tuple["Figure", ...]:
    """All figures of a module, by its ``globals()``, in the order of their definition."""
    return tuple(value for value in module.values() if isinstance(value, Figure))


@dataclass(frozen=True, slots=True)
class Figure:
    """Name of a metric, with its unit by the naming rules of Prometheus, and its description."""

    name: str
    help: str
    labels: tuple[str, ...] = ()
    counter: bool = False  # grows only, while the process runs; Prometheus adds "_total" to its name

    @property
    def shown(self) -> str:
        """The name of its samples, with labels."""
        name = f"{self.name}_total" if self.counter else self.name
        return f"{name}{{{', '.join(self.labels)}}}" if self.labels else name

    def of(self, value: float) -> GaugeMetricFamily | CounterMetricFamily:
        """One value without labels."""
        return self.by({(): value})

    def by(self, values: Mapping[tuple[str, ...], float]) -> GaugeMetricFamily | CounterMetricFamily:
        """One value for each set of labels, in the order of `labels`."""
        family = (CounterMetricFamily if self.counter else GaugeMetricFamily)(self.name, self.help, labels=self.labels)
        for labels, value in values.items():
            family.add_metric(labels, value)
        return family
