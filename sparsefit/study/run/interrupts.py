"""Ctrl-C twice: the first asks a run to finish what it is at, the second stops it at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def counted_interrupts(asked: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Inside, the first interrupt calls ``asked``; what is yielded tells whether there was one.

    The second raises KeyboardInterrupt, and no third is heard any more. Where somebody else
    handles interrupts, or this is not the main thread, all stays as it is.
    """
    mine = threading.current_thread() is threading.main_thread()
    if not mine or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: False
        return
    heard: list[bool] = []

    def hear(_signal: int, _frame: Any) -> None:
        if heard:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            raise KeyboardInterrupt
        heard.append(True)
        asked()

    signal.signal(signal.SIGINT, hear)
    try:
        yield lambda: bool(heard)
    finally:
        if signal.getsignal(signal.SIGINT) is hear:
            signal.signal(signal.SIGINT, signal.default_int_handler)
