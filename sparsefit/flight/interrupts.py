"""Ctrl-C while compiled code calls Python: an exception inside the call back ends the process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_kept() -> Iterator[list[int]]:
    """Keep each Ctrl-C in the list that is yielded; what it does, it does at the end of the block.

    Only the main thread is ever interrupted; in any other this does nothing.
    """
    kept: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield kept
        return
    signal.signal(signal.SIGINT, lambda number, _: kept.append(number))
    try:
        yield kept
    finally:
        signal.signal(signal.SIGINT, before)
    if kept:
        signal.raise_signal(signal.SIGINT)
