"""The answers of a study on disk: `cases.parquet`, `weights.parquet`, and where they stand."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sparsefit.errors import InputError
from sparsefit.score import strongest
from sparsefit.study.run.execution import Outcome
from sparsefit.study.run.scale_columns import ScaleColumns
from sparsefit.study.run.yardsticks import PARAMETERS
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.plan import Case
from sparsefit.study.spec.study import Study
from sparsefit.whole_file import whole_file

CASES = "cases.parquet"
WEIGHTS = "weights.parquet"

TEXT, REAL, WHOLE, FLAG = pa.string(), pa.float64(), pa.int64(), pa.bool_()
SINGLE = pa.float32()  # of what seven digits are enough
DENSE = ("est_", "se_", "low_", "high_", "bound_", "certificate", "seconds", "extent")
# `samples` and `columns` are 0 where no library was built; what is not known is NaN or "".
COLUMNS = {
    "case_id": TEXT,
    "study": TEXT,
    "flight": WHOLE,
    "split": TEXT,
    "protocol": TEXT,
    "backend": TEXT,
    "settings": TEXT,
    "label": TEXT,
    "status": TEXT,
    "reason": TEXT,
    "true_mean_velocity": REAL,
    "true_length_scale": REAL,
    "true_timescale": REAL,
    "est_mean_velocity": REAL,
    "est_length_scale": REAL,
    "est_timescale": REAL,
    "grid_length_scale": REAL,
    "hit": FLAG,
    "certificate_kind": TEXT,
    "certificate": SINGLE,
    "seconds": SINGLE,
    "samples": WHOLE,
    "columns": WHOLE,
    **{entry.name: TEXT if entry.type == "str" else REAL for entry in fields(ScaleColumns)},
    "flow": TEXT,
    "extent": SINGLE,
    "se_mean_velocity": SINGLE,
    "se_length_scale": SINGLE,
    "se_timescale": SINGLE,
    "low_mean_velocity": REAL,
    "low_length_scale": REAL,
    "low_timescale": REAL,
    "high_mean_velocity": REAL,
    "high_length_scale": REAL,
    "high_timescale": REAL,
    "bound_mean_velocity": SINGLE,
    "bound_length_scale": SINGLE,
    "bound_timescale": SINGLE,
}


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
    """The rows of `cases.parquet`, one per outcome, with fixed column types."""
    swept = {factor.key: _level_type(factor.levels) for factor in study.sweep}
    schema = COLUMNS | swept
    truths: dict[tuple[int, object], dict[str, object]] = {}
    columns: dict[str, list[object]] = {name: [] for name in schema}
    for outcome in ordered:
        cell = study.cells[outcome.cell]
        variant = (outcome.flight, cell.setup.flights)
        if variant not in truths:
            truths[variant] = _truth(study, outcome.flight, cell)
        row = _planned(study, outcome.flight, cell) | truths[variant] | vars(outcome)
        row |= {key: _level(cell.levels[key], kind) for key, kind in swept.items()}
        for name, values in columns.items():
            values.append(row[name])
    return pa.table({name: pa.array(values, type=schema[name]) for name, values in columns.items()})


def _planned(study: Study, flight: int, cell: Cell) -> dict[str, object]:
    return {
        "case_id": Case(flight, cell).case_id,
        "study": study.name,
        "split": study.split(flight),
        "protocol": cell.protocol,
        "backend": cell.backend,
        "settings": cell.canonical_settings,
        "label": cell.label,
    }


def _truth(study: Study, flight: int, cell: Cell) -> dict[str, object]:
    flow = study.draw(flight, cell).flow
    if flow is None:
        return {"flow": "none"} | {f"true_{name}": math.nan for name in PARAMETERS}
    flow = strongest(flow)
    return {
        "flow": "cellular",
        "true_mean_velocity": flow.mean_velocity,
        "true_length_scale": flow.length_scale,
        "true_timescale": flow.timescale,
    }


def _level_type(levels: Sequence[object]) -> pa.DataType:
    """Numbers stay numbers; every other level is text."""
    plain = all(isinstance(one, int | float) and not isinstance(one, bool) for one in levels)
    return REAL if plain else TEXT


def _level(value: object, kind: pa.DataType) -> object:
    if kind == TEXT:
        return value if isinstance(value, str) else canonical_json(value)
    return value


def _weights_table(study: Study, ordered: Sequence[Outcome]) -> pa.Table:
    rows = [
        (Case(outcome.flight, study.cells[outcome.cell]).case_id, scale, weight)
        for outcome in ordered
        for scale, weight in outcome.weights
    ]
    types: Mapping[str, pa.DataType] = {"case_id": TEXT, "length_scale": REAL, "weight": REAL}
    return pa.table(
        {
            name: pa.array([row[i] for row in rows], type=kind)
            for i, (name, kind) in enumerate(types.items())
        }
    )


def _is_dense(field: pa.Field) -> bool:
    return bool(pa.types.is_floating(field.type)) and field.name.startswith(DENSE)


def _replace(rows: pa.Table, path: Path) -> None:
    with whole_file(path) as file:
        # Numbers that never repeat pack best by bytes of equal rank, all else as a dictionary.
        dense = [field.name for field in rows.schema if _is_dense(field)]
        pq.write_table(
            rows,
            file,
            compression="zstd",
            compression_level=9,
            use_dictionary=[name for name in rows.column_names if name not in dense],
            column_encoding=dict.fromkeys(dense, "BYTE_STREAM_SPLIT"),
        )
