"""Ctrl-C while compiled code calls Python: an exception inside the call back ends the process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_kept() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C until the function that is yielded is called, or the block ends.

    It then does what it would have done: raise KeyboardInterrupt, call the handler of whoever set
    one, or nothing, and the work goes on. Only the main thread is ever interrupted; in any other
    this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield lambda: None
        return
    kept: list[int] = []

    def keep() -> None:
        signal.signal(signal.SIGINT, lambda number, _: kept.append(number))

    def released() -> None:
        if kept:
            kept.clear()
            signal.signal(signal.SIGINT, before)
            signal.raise_signal(signal.SIGINT)
            keep()

    keep()
    try:
        yield released
        released()
    finally:
        signal.signal(signal.SIGINT, before)
