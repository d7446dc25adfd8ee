"""One record a line, with a checksum: what workers send, and the rows of a run that goes on.

    1c291ca3 {"flight":0,"cell":3,...}\n

A line that was torn, flipped or overwritten is known by its CRC-32 and is none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, TypeAlias
from zlib import crc32

from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.solver_columns import EVERY_KIND

Record: TypeAlias = dict[str, Any]


def packed(record: Mapping[str, object]) -> bytes:
    """The line of a record; ValueError or TypeError where JSON cannot hold it."""
    body = json.dumps(record, separators=(",", ":")).encode()
    return b"%08x %s\n" % (crc32(body), body)


def unpacked(line: bytes) -> Record | None:
    """The record of a line; None where it is not whole."""
    if line[8:9] != b" " or line[-1:] != b"\n":
        return None
    body = line[9:-1]
    if line[:8] != b"%08x" % crc32(body):
        return None
    try:
        record = json.loads(body)
    except (ValueError, RecursionError):  # not written by us
        return None
    return record if isinstance(record, dict) else None


def record_of(outcome: Outcome) -> Record:
    """An outcome as JSON holds it: NaN is null, and a float reads back the same."""
    return {
        "flight": outcome.flight,
        "cell": outcome.cell,
        "status": outcome.status,
        "reason": outcome.reason,
        "values": {name: _finite(value) for name, value in outcome.values.items()},
        "shared_seconds": outcome.shared_seconds,
        "weights": [[_finite(value) for value in pair] for pair in outcome.weights],
        "version": outcome.version,
    }


def outcome_of(record: Mapping[str, Any]) -> Outcome:
    """The outcome that `record_of` told; columns that are no longer there are left out."""
    told = record["values"].items()
    values = {name: EVERY_KIND[name].of(value) for name, value in told if name in EVERY_KIND}
    return Outcome(
        record["flight"],
        record["cell"],
        record["status"],
        record["reason"],
        values,
        record["shared_seconds"],
        tuple((_number(scale), _number(weight)) for scale, weight in record["weights"]),
        record["version"],
    )


def _finite(value: object) -> object:
    """None for NaN; infinity, which JSON has not, as the text that `float` reads."""
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return None if math.isnan(value) else str(value)


def _number(value: float | str | None) -> float:
    return math.nan if value is None else float(value)
