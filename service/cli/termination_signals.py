"""The signals that end a program, for a program that has to stop a machine first."""

import signal
from collections.abc import Callable
from types import FrameType
from typing import Self

_SIGNALS = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "the terminal was lost"}
_Handler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None  # as `signal.signal` has it


class TerminationSignals:
    """While the block runs, the first signal that ends a program raises KeyboardInterrupt; those after it wait.

    `by` says which it was. What the caller of the program has set to be ignored (nohup) stays ignored.
    """

    def __init__(self) -> None:
        self.by = ""
        self._before: dict[signal.Signals, _Handler] = {}

    def __enter__(self) -> Self:
        for name in _SIGNALS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._tell)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _tell(self, number: int, _: FrameType | None) -> None:
        if not self.by:
            self.by = _SIGNALS[signal.Signals(number).name]
            raise KeyboardInterrupt
