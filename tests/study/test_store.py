"""What is written reads back the same, and half a file is never read as a whole one."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sparsefit.errors import InputError
from sparsefit.study import Study, cells, plan, read_cases, read_weights, run
from sparsefit.study.evidence.tables import TABLES
from sparsefit.study.run import partial
from sparsefit.study.run.columns import COLUMNS, KINDS
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.lines import packed, record_of
from sparsefit.study.run.manifest import git_commit, read_manifest, write_manifest
from sparsefit.study.run.outcome import Outcome, Stage
from sparsefit.study.run.pace import Pace
from sparsefit.study.run.store import write_cases
from sparsefit.study.spec.identity import identities
from tests.study.small_study import small_study

TEXT = (
    small_study("s", count=2)
    + """\
[[backends]]
name = "lasso"
alpha_fraction = [0.1, 0.3]
[sweep]
"flights.thrust_acceleration" = [[5.0, 3.0], [2, 1]]
"flights.velocity_noise" = [0, 0.5]
"library.target" = ["flow-velocity", "acceleration"]
[outputs]
figures = ["weights"]
"""
)


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "s.toml").write_text(TEXT)
    return Study.load(tmp_path / "s.toml")


def outcomes(study: Study) -> list[Outcome]:
    return [Outcome(case.flight, case.cell.index, "skipped", "why") for case in plan(study)]


def test_columns_and_types(study: Study, tmp_path: Path) -> None:
    write_cases(study, reversed(outcomes(study)), tmp_path)
    cases = read_cases(tmp_path)
    swept = [factor.key for factor in study.sweep]
    assert list(cases.columns) == [*(column.name for column in COLUMNS), *swept]
    assert list(cases["case_id"]) == [case.case_id for case in plan(study)]
    schema = pq.read_schema(tmp_path / "cases.parquet")
    for column in COLUMNS:
        assert schema.field(column.name).type == pa.type_for_alias(column.kind.arrow)
    assert str(schema.field("flights.velocity_noise").type) == "double"
    assert set(cases["flights.thrust_acceleration"]) == {"[5,3]", "[2,1]"}
    assert set(cases["library.target"]) == {"flow-velocity", "acceleration"}
    assert [json.loads(text)["alpha_fraction"] for text in cases["settings"][:2]] == [0.1, 0.3]


def test_types_do_not_depend_on_the_values(study: Study, tmp_path: Path) -> None:
    """A study in which nothing succeeded has the same columns of the same types."""
    write_cases(study, outcomes(study), tmp_path)
    failed = read_cases(tmp_path).dtypes
    good = [replace(one, values={"est_mean_velocity": 1.0}, reason="") for one in outcomes(study)]
    write_cases(study, good, tmp_path)
    pd.testing.assert_series_equal(failed, read_cases(tmp_path).dtypes)


def test_missing_and_broken_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="run the study first"):
        read_cases(tmp_path)
    (tmp_path / "cases.parquet").write_bytes(b"PAR1 half")
    with pytest.raises(InputError, match="not readable"):
        read_cases(tmp_path)


@pytest.mark.usefixtures("in_process")
def test_a_whole_run_with_weights_and_manifest(study: Study, tmp_path: Path) -> None:
    summary = run(study, tmp_path / "results", processes=1)
    cases, weights = read_cases(summary.folder), read_weights(summary.folder)
    estimated = cases[cases["grid_length_scale"].notna()]
    assert len(estimated) > 20
    for case in estimated.itertuples():
        mine = weights[weights["case_id"] == case.case_id]
        assert len(mine) == 4
        assert mine.loc[mine["weight"].idxmax(), "length_scale"] == case.grid_length_scale
    assert (cases["columns"] == 32).all()
    manifest = read_manifest(summary.folder)
    assert manifest is not None
    assert manifest["study_hash"] == study.hash
    assert manifest["statuses"] == dict(sorted(summary.statuses.items()))
    assert sum(summary.statuses.values()) == manifest["cases"] == study.planned
    assert {"python", "numpy", "scipy", "clarabel"} <= set(manifest["versions"])  # type: ignore[call-overload]


def test_unfinished_rows_read_back_exactly(study: Study, tmp_path: Path) -> None:
    partial.begin(tmp_path, {"study_hash": "x"})
    names = identities(study)
    rows = [
        Outcome(
            0,
            1,
            "ok",
            "",
            {
                "est_length_scale": 0.1 + 0.2,
                "hit": True,
                "extent": math.nan,
                "se_timescale": math.inf,
            },
        ),
        Outcome(0, 2, "error", 'quote " and\nline', weights=((1.0, -2.0), (1.2, math.nan))),
        Outcome(0, 3, "ok", "", {"certificate_kind": "duality_gap", "certificate": 1e-300}, 1 / 3),
    ]
    with partial.appending(tmp_path) as writer:
        for row in reversed(rows):
            writer.append(row, names[row.cell])
    found = Ledger.read(study, tmp_path)
    assert [repr(row) for row in found.rows(tmp_path)] == [repr(row) for row in rows]
    assert found.statuses == {"ok": 2, "error": 1}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
def test_a_full_disk_is_told_with_the_file_of_the_rows(study: Study) -> None:
    with Path("/dev/full").open("ab", buffering=0) as file:
        writer = partial.Writer(file)
        with pytest.raises(InputError, match=r"^cannot write /dev/full: No space .*; make room"):
            writer.append(outcomes(study)[0], "0")


def test_a_link_that_waits_for_the_cases_is_not_followed(study: Study, tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("precious")
    for name in ("cases.parquet", "cases.parquet.writing", "manifest.json.writing"):
        (tmp_path / name).symlink_to(tmp_path / "victim")
    write_cases(study, outcomes(study), tmp_path)
    assert (tmp_path / "victim").read_text() == "precious"
    assert len(read_cases(tmp_path)) == study.planned


@pytest.mark.parametrize("torn", [b'{"flight":', b"\x00\x00\n", b"{}\n", b'{"flight":1}\nmore'])
def test_what_is_not_whole_is_passed_over_and_counted(
    study: Study, tmp_path: Path, torn: bytes
) -> None:
    partial.begin(tmp_path, {})
    names = identities(study)
    with partial.appending(tmp_path) as writer:
        writer.append(Outcome(0, 0, "ok"), names[0])
    path = tmp_path / ".partial" / "rows.jsonl"
    path.write_bytes(path.read_bytes() + torn)
    with partial.appending(tmp_path) as writer:
        writer.append(Outcome(0, 1, "ok"), names[1])
        writer.append(Outcome(0, 0, "error"), names[0])  # the later one counts
    found = Ledger.read(study, tmp_path)
    assert [(row.cell, row.status) for row in found.rows(tmp_path)] == [(0, "error"), (1, "ok")]
    assert found.damaged == len(torn.splitlines())


def test_a_flipped_bit_in_a_row_is_seen(study: Study, tmp_path: Path) -> None:
    partial.begin(tmp_path, {})
    with partial.appending(tmp_path) as writer:
        writer.append(Outcome(0, 0, "ok", "why", {"samples": 3}), identities(study)[0])
    path = tmp_path / ".partial" / "rows.jsonl"
    whole = path.read_bytes()
    for place in range(0, len(whole) - 1, 7):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        found = Ledger.read(study, tmp_path)
        assert (found.done.sum(), found.damaged > 0) == (0, True)


def test_a_flipped_bit_in_the_cases_is_seen(study: Study, tmp_path: Path) -> None:
    write_cases(study, outcomes(study), tmp_path)
    nothing = {"wall_seconds": 0.0, "solver_seconds": 0.0, "processes": 1, "resumed": 0}
    write_manifest(study, tmp_path, statuses={}, **nothing)  # type: ignore[arg-type]
    path = tmp_path / "cases.parquet"
    whole = path.read_bytes()
    assert len(read_cases(tmp_path)) == study.planned
    for place in range(5, len(whole), len(whole) // 40):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        with pytest.raises(InputError, match=r"not what was written.*--fresh"):
            read_cases(tmp_path)


def timeless(outcome: Outcome) -> Outcome:
    return replace(outcome, values={**outcome.values, "seconds": 0.0})


def test_what_is_left_to_do_does_not_change_what_comes_out(study: Study) -> None:
    """A resumed run repeats the whole path of which one point is missing."""
    every = cells(study)
    whole = {row.cell: row for row in run_flight(study, 0, every) if isinstance(row, Outcome)}
    assert sorted(whole) == [cell.index for cell in every]
    for cell in every[:4]:
        (row,) = (row for row in run_flight(study, 0, [cell]) if isinstance(row, Outcome))
        assert repr(timeless(row)) == repr(timeless(whole[cell.index]))


def test_a_path_is_one_stage_and_alone_it_is_not(study: Study) -> None:
    every = cells(study)[:2]
    for alone, fits in ((False, [2]), (True, [1, 1])):
        events = run_flight(study, 0, every, alone=alone)
        stages = [event for event in events if isinstance(event, Stage)]
        assert [stage.fits for stage in stages if stage.name == "fitting"] == fits


def test_time_left_weighs_each_cell_by_what_it_took() -> None:
    pace = Pace.start(pd.Series([3, 3, 2, 4]).to_numpy(), processes=2)
    pace.note(0, 1.0)
    assert pace.eta is None  # one cell of four stands for little
    pace.note(1, 50.0)
    pace.note(2, 3.0)
    assert pace.eta == (2 * 1.0 + 2 * 50.0 + 1 * 3.0 + 4 * 3.0) / 2


def test_a_commit_or_nothing() -> None:
    commit = git_commit()
    assert commit is None or len(commit.removesuffix("+changes")) == 40


def test_a_file_from_before_there_were_bounds_is_still_read(study: Study, tmp_path: Path) -> None:
    write_cases(study, outcomes(study), tmp_path)
    new = [name for name in KINDS if name.startswith(("se_", "low_", "high_", "bound_"))]
    old = pq.read_table(tmp_path / "cases.parquet").drop_columns([*new, "flow", "extent"])
    pq.write_table(old, tmp_path / "cases.parquet")
    found = read_cases(tmp_path)
    assert len(new) == 12
    for name in ("efficiency", "coverage", "identifiability", "errors"):
        assert len(TABLES.make(name, study, found).rows) > 0


def test_rows_lack_what_is_new_and_lose_what_is_gone(study: Study, tmp_path: Path) -> None:
    partial.begin(tmp_path, {})
    row = record_of(replace(outcomes(study)[0], values={"samples": 3}))
    row["values"]["gone"] = 1.0
    with partial.appending(tmp_path) as rows:
        rows.file.write(packed({"identity": identities(study)[0], **row}))
    (found,) = Ledger.read(study, tmp_path).rows(tmp_path)
    assert found["samples"] == 3
    assert math.isnan(float(found["extent"]))
    assert dict(found.values) == {"samples": 3}


@pytest.mark.parametrize("planted", ["folder", "pipe", "link"])
def test_what_waits_in_the_place_of_the_rows_is_not_followed(
    study: Study, tmp_path: Path, planted: str
) -> None:
    partial.begin(tmp_path, {})
    path, victim = tmp_path / partial.FOLDER / partial.ROWS, tmp_path / "victim"
    victim.write_text("precious")
    if planted == "folder":
        path.mkdir()
    elif planted == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(victim)

    def look_and_write() -> None:
        Ledger.read(study, tmp_path)
        with partial.appending(tmp_path) as rows:
            rows.append(outcomes(study)[0], "0")

    with pytest.raises(InputError, match=r"rows\.jsonl"):
        look_and_write()
    assert victim.read_text() == "precious"


def test_what_is_no_table_of_cases_is_refused_beside_any_manifest(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text("[" * 100_000)
    pd.DataFrame({"case_id": ["0000-1"], "status": ["ok"]}).to_parquet(tmp_path / "cases.parquet")
    with pytest.raises(InputError, match='no cases of a study, without a column "reason"'):
        read_cases(tmp_path)
