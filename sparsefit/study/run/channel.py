"""What a worker tells its parent: a record a line, checked, and never waited for.

Code of others runs in the worker and may write anything anywhere. A line that is not whole, or
is none, ends the worker; it cannot hold up the parent.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from sparsefit.study.run.lines import Record, packed, unpacked

CHUNK = 1 << 16
CHUNKS = 16  # that are read of one worker at a time
LONGEST = 64 << 20  # bytes of one record
GARBLED = "the message channel of the worker process was written into"


class Garbled(Exception):  # noqa: N818 - says what is the matter
    """What came through the channel is no record."""


@dataclass
class Sender:
    """The worker's end; a copy of the process, made by code that forks, ends where it would send.

    owner: the process whose channel it is.
    """

    descriptor: int
    owner: int

    def send(self, record: Mapping[str, object]) -> None:
        """Write all of it; BrokenPipeError where the parent is gone."""
        if os.getpid() != self.owner:
            os._exit(0)
        line = packed(record)
        while line:
            line = line[os.write(self.descriptor, line) :]


@dataclass
class Receiver:
    """The parent's end, which does not block; `waiting` holds the start of a record."""

    descriptor: int
    waiting: bytes = b""
    more: bool = False

    def __post_init__(self) -> None:
        os.set_blocking(self.descriptor, False)

    def records(self) -> Iterator[Record]:
        """Those that have come by now; `more` where that was too much for one time.

        Raises:
            EOFError: the other end is closed, and all was read.
            Garbled: what came is no record.
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
                record = unpacked(line + b"\n")
                if record is None:
                    raise Garbled
                yield record
