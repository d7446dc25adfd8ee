"""The answers of a study on disk: `cases.parquet`, `weights.parquet`, and where they stand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sparsefit.errors import InputError, is_real
from sparsefit.flight.flow import Cells
from sparsefit.score import strongest
from sparsefit.study.run.columns import COLUMNS, KINDS, LEVEL, TEXT, Column, Planned
from sparsefit.study.run.folder import CASES, WEIGHTS
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.spec.design import Factor
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.plan import Case, flight_key
from sparsefit.study.spec.study import Study
from sparsefit.whole_file import whole_file

WEIGHT_COLUMNS = {"case_id": TEXT, "length_scale": LEVEL, "weight": LEVEL}


def read_cases(folder: str | Path) -> pd.DataFrame:
    """The rows of a finished study from its results folder, `results/<name>`.

    Raises:
        InputError: if there are none yet, or the file is not readable.
    """
    return _read(Path(folder) / CASES)


def read_weights(folder: str | Path) -> pd.DataFrame:
    """`case_id, length_scale [m], weight` of a study whose figures include `weights`."""
    return _read(Path(folder) / WEIGHTS)


def _read(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise InputError(f"{path}: no such file: run the study first (sparsefit study run)")
    try:
        frame: pd.DataFrame = pq.read_table(path).to_pandas()
    except (OSError, pa.ArrowInvalid) as error:
        cause = " ".join(str(error).split())
        raise InputError(f"{path}: not readable ({cause}): run the study with --fresh") from None
    return frame


def write_cases(study: Study, outcomes: Iterable[Outcome], folder: Path) -> None:
    """All rows in plan order, in one atomic step; the weights too where the study keeps them."""
    ordered = sorted(outcomes, key=lambda outcome: (outcome.flight, outcome.cell))
    if study.store_weights:
        _replace(_weights_table(study, ordered), folder / WEIGHTS)
    _replace(cases_table(study, ordered), folder / CASES)


def cases_table(study: Study, ordered: Sequence[Outcome]) -> pa.Table:
    """The rows of `cases.parquet`, one per outcome: `COLUMNS`, then one per swept factor."""
    planned = list(_planned(study, ordered))
    arrays = {column.name: _array(column, planned, ordered) for column in COLUMNS}
    for factor in study.sweep:
        levels = (row.case.cell.levels[factor.key] for row in planned)
        arrays[factor.key] = _levels_array(factor, levels)
    return pa.table(arrays)


def _planned(study: Study, ordered: Iterable[Outcome]) -> Iterator[Planned]:
    flows: dict[tuple[int, object], Cells | None] = {}
    for outcome in ordered:
        cell = study.cells[outcome.cell]
        flown = (outcome.flight, flight_key(cell))
        if flown not in flows:
            flow = study.draw(outcome.flight, cell).flow
            flows[flown] = None if flow is None else strongest(flow)
        yield Planned(study, Case(outcome.flight, cell), flows[flown])


def _array(column: Column, planned: Sequence[Planned], ordered: Sequence[Outcome]) -> pa.Array:
    if column.planned:
        values = [column.kind.of(column.planned(row)) for row in planned]
    else:
        values = [outcome[column.name] for outcome in ordered]
    return pa.array(values, type=pa.type_for_alias(column.kind.arrow))


def _levels_array(factor: Factor, levels: Iterable[object]) -> pa.Array:
    """Where all levels of a factor are numbers they stay numbers; else all are text."""
    if all(is_real(level) for level in factor.levels):
        return pa.array(levels, type=pa.float64())
    texts = (level if isinstance(level, str) else canonical_json(level) for level in levels)
    return pa.array(texts, type=pa.string())


def _weights_table(study: Study, ordered: Iterable[Outcome]) -> pa.Table:
    rows = [
        (Case(outcome.flight, study.cells[outcome.cell]).case_id, *pair)
        for outcome in ordered
        for pair in outcome.weights
    ]
    return pa.table(
        {
            name: pa.array([row[place] for row in rows], type=pa.type_for_alias(kind.arrow))
            for place, (name, kind) in enumerate(WEIGHT_COLUMNS.items())
        }
    )


def _replace(rows: pa.Table, path: Path) -> None:
    dense = [name for name in rows.column_names if name in KINDS and KINDS[name].dense]
    with whole_file(path) as file:
        pq.write_table(
            rows,
            file,
            compression="zstd",
            compression_level=9,
            use_dictionary=[name for name in rows.column_names if name not in dense],
            column_encoding=dict.fromkeys(dense, "BYTE_STREAM_SPLIT"),
        )
