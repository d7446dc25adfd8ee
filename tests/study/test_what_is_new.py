"""Only what is new is computed: rows belong to what determines their numbers, not to a file."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sparsefit.errors import InputError
from sparsefit.study import Study, read_cases, read_weights, run, status
from sparsefit.study.run import flight_kind
from sparsefit.study.run.manifest import read_manifest
from sparsefit.study.spec.flights import FlightRules
from sparsefit.study.spec.identity import identities
from tests.conftest import run_in_process
from tests.study.small_study import small_study

BODY = (
    small_study("n", count=2)
    + """\
[[backends]]
name = "lasso"
alpha_fraction = [0.3, 0.1]
[[backends]]
name = "least-squares"
[sweep]
"flights.velocity_noise" = [0.0, 0.2]
"""
)
PLANNED = 2 * 2 * 3

Load = Callable[..., Study]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def _load(*changes: tuple[str, str], more: str = "") -> Study:
        text = BODY
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "n.toml"
        path.write_text(text + more)
        return Study.load(path)

    return _load


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of the study, which ran once."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "n.toml").write_text(BODY)
    with pytest.MonkeyPatch.context() as patch:
        run_in_process(patch)
        assert run(Study.load(folder / "n.toml"), folder, processes=1).computed == PLANNED
    return folder / "n"


@pytest.fixture
def went(tmp_path: Path, whole: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "n"))


def by_identity(folder: Path) -> pd.DataFrame:
    cases = read_cases(folder)
    return cases.set_index(cases["identity"] + cases["flight"].astype(str)).sort_index()


NO_LSQ = ('[[backends]]\nname = "least-squares"\n', "")
RENAMED = ('name = "least-squares"\n', 'name = "least-squares"\nlabel = "plain"\n')
TIMEOUT = ("[library]", "[run]\ncase_timeout = 5.0\n[library]")

pytestmark = pytest.mark.usefixtures("in_process")


@pytest.mark.parametrize(
    ("changes", "computed", "dropped"),
    [
        ([("count = 2", "count = 3")], 6, 0),
        ([("count = 2", "count = 1")], 0, 6),
        ([("[0.3, 0.1]", "[0.3, 0.1, 0.03]")], 4, 0),
        ([NO_LSQ], 0, 4),
        ([("[0.0, 0.2]", "[0.2, 0.5]")], 6, 6),
        ([RENAMED], 0, 0),
        ([TIMEOUT], 0, 0),
        ([("length_scale = { uniform = [3.0, 6.0] }", "length_scale = 4.0")], None, 0),
        ([("seed = 3", "seed = 4")], None, 0),
        ([("count = 2", "count = 3"), ("uniform", "linspace")], None, 0),
    ],
)
def test_a_changed_study_computes_what_is_new_and_drops_what_it_no_longer_plans(
    went: Path,
    load: Load,
    changes: list[tuple[str, str]],
    computed: int | None,
    dropped: int,
) -> None:
    before = by_identity(went)
    study = load(*changes)
    if computed is None:  # no case of it was there
        with pytest.raises(InputError, match="no case of it is of this one: study run --fresh"):
            run(study, went.parent, processes=1)
        return
    expected = study.planned - computed
    assert status(study, went.parent).done == expected
    summary = run(study, went.parent, processes=1)
    assert (summary.computed, summary.resumed, summary.dropped) == (computed, expected, dropped)
    assert summary.finished
    after = by_identity(went)
    assert len(after) == study.planned
    kept = after.index.intersection(before.index)
    assert len(kept) == expected
    numbers = [name for name in before if name not in ("study", "label", "split")]
    pd.testing.assert_frame_equal(after.loc[kept, numbers], before.loc[kept, numbers])
    assert list(read_cases(went)["flight"]) == sorted(after["flight"])  # in plan order
    assert run(study, went.parent, processes=1).nothing_to_do


def test_rows_that_are_planned_again_come_back(went: Path, load: Load) -> None:
    before = by_identity(went)
    fewer = run(load(NO_LSQ, ("[0.0, 0.2]", "[0.2]")), went.parent, processes=1)
    assert (fewer.computed, fewer.dropped, fewer.planned) == (0, 8, 4)
    some = run(load(NO_LSQ), went.parent, processes=1)
    assert (some.computed, some.resumed) == (0, 8)
    again = run(load(), went.parent, processes=1)
    assert (again.computed, again.finished) == (0, True)
    pd.testing.assert_frame_equal(by_identity(went), before)
    assert not (went / "unplanned.jsonl").exists()
    run(load(NO_LSQ), went.parent, processes=1)
    assert run(load(), went.parent, processes=1, fresh=True).computed == PLANNED
    assert not (went / "unplanned.jsonl").exists()


def test_weights_go_along_with_the_rows_that_are_kept(tmp_path: Path, load: Load) -> None:
    figures = '[outputs]\nfigures = ["weights"]\n'
    run(load(more=figures), tmp_path, processes=1)
    before = read_weights(tmp_path / "n")
    assert run(load(("count = 2", "count = 3"), more=figures), tmp_path, processes=1).computed == 6
    after = read_weights(tmp_path / "n")
    assert after["case_id"].nunique() == 18
    kept = after[after["case_id"].isin(before["case_id"])].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before)


def test_failed_rows_are_tried_again_where_that_is_asked_for(
    tmp_path: Path, load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = load(('name = "lasso"', 'name = "lasso"\nlabel = "l"'))
    real = flight_kind.outcomes

    def failing(*told):  # type: ignore[no-untyped-def]
        for outcome, seconds in real(*told):
            bad = outcome.cell == 0
            yield (type(outcome)(outcome.flight, 0, "timeout") if bad else outcome), seconds

    monkeypatch.setattr(flight_kind, "outcomes", failing)
    assert run(study, tmp_path, processes=1).statuses["timeout"] == 2
    monkeypatch.setattr(flight_kind, "outcomes", real)
    assert run(study, tmp_path, processes=1).nothing_to_do
    assert run(study, tmp_path, processes=1, retry_failed=True, only=["least*"]).nothing_to_do
    one = read_cases(tmp_path / "n")["case_id"][0]
    first = run(study, tmp_path, processes=1, retry_failed=True, only=[one])
    assert (first.computed, first.statuses["timeout"]) == (1, 1)
    second = run(study, tmp_path, processes=1, retry_failed=True)
    assert (second.computed, second.resumed) == (1, PLANNED - 1)
    assert "timeout" not in second.statuses


def test_rows_of_other_code_are_told_and_renewed(
    went: Path, load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = load()
    assert run(study, went.parent, processes=1).stale == 0
    monkeypatch.setattr(flight_kind, "version_of", lambda _: "9.9+new")
    assert run(study, went.parent, processes=1).stale == PLANNED
    assert status(study, went.parent).stale == PLANNED
    renewed = run(study, went.parent, processes=1, renew_stale=True, only=["lasso"])
    assert (renewed.computed, renewed.stale) == (8, 4)
    assert run(study, went.parent, processes=1, renew_stale=True).computed == 4
    assert set(read_cases(went)["version"]) == {"9.9+new"}


def test_only_leaves_the_rest_for_later(tmp_path: Path, load: Load) -> None:
    study = load()
    seen: list[tuple[int, int]] = []
    part = run(
        study,
        tmp_path,
        processes=1,
        only=["least-squares"],
        progress=lambda done, planned, _: seen.append((done, planned)),
    )
    assert (seen[0], seen[-1]) == ((0, 4), (4, 4))
    assert (part.computed, part.done, part.finished) == (4, 4, False)
    assert not (tmp_path / "n" / "cases.parquet").exists()
    with pytest.raises(InputError, match=r'called "ridge": give a back-end, .*lasso'):
        run(study, tmp_path, processes=1, only=["ridge"])
    assert run(study, tmp_path, processes=1).computed == PLANNED - 4


@pytest.mark.parametrize("lacking", [["identity", "version"], ["version"]])
def test_results_with_identities_of_old_or_none_count_for_the_same_study(
    went: Path, load: Load, lacking: list[str]
) -> None:
    old = pq.read_table(went / "cases.parquet").drop_columns(lacking)
    if "identity" in old.column_names:
        place = old.column_names.index("identity")
        old = old.set_column(place, "identity", pa.array(["0"] * len(old)))
    pq.write_table(old, went / "cases.parquet")
    manifest = read_manifest(went) or {}
    del manifest["sha256"]
    import json

    (went / "manifest.json").write_text(json.dumps(manifest))
    same = run(load(), went.parent, processes=1)
    assert (same.computed, same.stale) == (0, PLANNED)
    with pytest.raises(InputError, match="made by a different study"):
        run(load(("count = 2", "count = 3")), went.parent, processes=1)


def test_equal_cells_have_identities_of_their_own(load: Load) -> None:
    protocols = '[[protocols]]\nname = "a"\n[[protocols]]\nname = "b"\n'
    study = load(('[sweep]\n"flights.velocity_noise" = [0.0, 0.2]\n', protocols))
    named = identities(study)
    assert len(set(named)) == len(study.cells) == 6
    assert [one + "-2" for one in named[:3]] == list(named[3:])


def test_an_identity_tells_every_field_of_the_flight_rules() -> None:
    """They are told by hand, for speed: whoever adds a field adds it to `spec/identity.py`."""
    told = {"entries", "cells", "spectrum", "thrust_log"}
    assert {field.name for field in fields(FlightRules)} == told
