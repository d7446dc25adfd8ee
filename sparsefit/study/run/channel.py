"""What a worker tells its parent: a line a message, checked, and never waited for.

Code of others runs in the worker and may write anything anywhere. A message that is not whole, or
is none, ends the worker; it cannot hold up the parent.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

from sparsefit.study.run.lines import outcome_of, packed, record_of, unpacked
from sparsefit.study.run.outcome import Event, Outcome, Stage

CHUNK = 1 << 16
CHUNKS = 16  # that are read of one worker at a time
LONGEST = 64 << 20  # bytes of one message


@dataclass(frozen=True)
class Ready:
    """The worker has started, or has ended its job."""


Message = Event | Ready


class Garbled(Exception):  # noqa: N818 - says what is the matter
    """What came through the channel is no message."""


@dataclass
class Sender:
    """The worker's end; a copy of the process, made by code that forks, ends where it would send.

    owner: the process whose channel it is.
    """

    descriptor: int
    owner: int

    def send(self, message: Message) -> None:
        """Write all of it; BrokenPipeError where the parent is gone."""
        if os.getpid() != self.owner:
            os._exit(0)
        line = _line(message)
        while line:
            line = line[os.write(self.descriptor, line) :]


@dataclass
class Receiver:
    """The parent's end, which does not block; `waiting` holds the start of a message."""

    descriptor: int
    waiting: bytes = b""
    more: bool = False

    def __post_init__(self) -> None:
        os.set_blocking(self.descriptor, False)

    def messages(self) -> Iterator[Message]:
        """Those that have come by now; `more` where that was too much for one time.

        Raises:
            EOFError: the other end is closed, and all was read.
            Garbled: what came is no message of ours.
        """
        self.more = True
        for _ in range(CHUNKS):
            try:
                chunk = os.read(self.descriptor, CHUNK)
            except BlockingIOError:
                self.more = False
                return
            if not chunk:
                raise EOFError
            *whole, self.waiting = (self.waiting + chunk).split(b"\n")
            if len(self.waiting) > LONGEST:
                raise Garbled
            for line in whole:
                yield _message(line + b"\n")


def _line(message: Message) -> bytes:
    if isinstance(message, Ready):
        return packed({"ready": True})
    if isinstance(message, Stage):
        return packed({"stage": message.name, "cells": message.cells, "fits": message.fits})
    try:
        return packed(record_of(message))
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        reason = f"what was read cannot be written: {type(error).__name__}"
        return packed(record_of(Outcome(message.flight, message.cell, "error", reason)))


def _message(line: bytes) -> Message:
    record = unpacked(line)
    if record is None:
        raise Garbled
    if "ready" in record:
        return Ready()
    if "stage" in record:
        return Stage(record["stage"], tuple(record["cells"]), record["fits"])
    return outcome_of(record)
