"""What an entry of [outputs] may ask for: one's own study gets the pages of a shipped one."""

from __future__ import annotations

import itertools

import pytest

from sparsefit.errors import InputError
from sparsefit.study.evidence.answers import ANSWERS, sentences
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.measure import Failure
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.tables import TABLES, tables_of
from sparsefit.study.report.figures import FIGURES
from sparsefit.study.report.pages import check_outputs, write_report
from tests.study.test_figures import LEVELS, study, synthetic

NOISE = "flights.velocity_noise"
CASES = synthetic(6, LEVELS)
SMALL = synthetic(2, LEVELS[::2], ("paper",))


def read(**options: object) -> Asked:
    return ANSWERS.read(options)


def test_a_failure_counts_as_the_entry_says() -> None:
    (measure,) = read(measure="timescale-error", summary="mean", failures="miss").measures
    assert (measure.failure, measure.summary) == (Failure.MISS, "mean")
    (plain,) = read(measure="timescale-error").measures
    assert (plain.failure, plain.summary) == (Failure.INFINITE, "median")


def test_the_three_conventions_on_one_set_of_cases() -> None:
    cases = CASES.iloc[:4].assign(status=["ok", "ok", "ok", "error"])
    cases["est_timescale"] = cases["true_timescale"] * [1.1, 1.2, 1.3, 1.0]
    by = {
        failure: read(measure="timescale-error", failures=failure, summary="mean").first
        for failure in ("left out", "miss", "infinite")
    }
    told = [measure.summarise(cases) for measure in by.values()]
    assert told == [pytest.approx(20.0), pytest.approx(40.0), float("inf")]
    assert by["miss"].summarise(cases, "median") == pytest.approx(25.0)
    assert by["infinite"].summarise(cases, "median") == pytest.approx(20.0)  # an observed value


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"measure": "timescale-eror"}, 'did you mean "timescale-error"'),
        ({"compare": "seting"}, 'did you mean "settings"'),
        ({"failures": "ignored"}, "known: infinite, left out, miss"),
        ({"alnog": NOISE}, 'did you mean "along"'),
        ({"limits": ["five"]}, "key \"limits\" must be a number, not 'five'"),
        ({"along": 3}, 'key "along" must be text in quotes'),
        ({"at_least": 3}, 'key "at_least" must be an object'),
        ({"measure": "avarage seconds"}, 'unknown summary "avarage"'),
        ({"at_least": {"cels": 3.0}}, 'did you mean "cells"'),
        ({"band": "yes"}, 'key "band" must be true or false'),
    ],
)
def test_refusals_name_the_nearest(options: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        read(**options)


def test_the_check_names_file_and_kind() -> None:
    for kind in ("tables", "figures", "answers"):
        with pytest.raises(InputError, match=rf"^demo.toml: \[outputs\].{kind}: unknown"):
            check_outputs(study(**{kind: ("nonesuch",)}))


@pytest.mark.parametrize("compare", list(TABLES.compares))
@pytest.mark.parametrize("measure", ["timescale-error", "seconds", "hits"])
def test_every_table_takes_every_measure(compare: str, measure: str) -> None:
    if compare == "reference":
        return
    entry = {"name": "mine", "measure": measure, "compare": compare, "limits": [5.0]}
    tables = tables_of(study(tables=(entry | {"along": NOISE},)), SMALL)
    assert tables["mine"].rows


@pytest.mark.parametrize(
    ("compare", "measure"),
    [
        *(("settings", measure) for measure in MEASURES),
        *itertools.product(("protocols", "spread", "until"), ("length-scale-efficiency", "hits")),
    ],
)
def test_every_sentence_takes_every_measure(compare: str, measure: str) -> None:
    entry = {"measure": measure, "compare": compare, "along": NOISE, "limits": [5.0]}
    (said,) = sentences(study(answers=(entry,)), SMALL)
    assert said.endswith(".")
    assert "nan" not in said


@pytest.mark.usefixtures("not_laid_out")
@pytest.mark.parametrize("compare", ["settings", "protocols", "until"])
def test_a_picture_of_ones_own(compare: str) -> None:
    entry = {"measure": "seconds", "compare": compare, "along": NOISE, "over": "setting"}
    assert FIGURES.read(entry).file_name == f"seconds-{compare}"
    assert FIGURES.make(entry, study(), CASES, None).axes


@pytest.mark.usefixtures("blank_pictures")
def test_pages_of_a_study_of_ones_own(tmp_path) -> None:  # type: ignore[no-untyped-def]
    entry = {"name": "speed", "measure": ["seconds", "mean-velocity-error"]}
    asked = study(tables=(entry,), figures=("errors",), answers=({"measure": "seconds"},))
    written = write_report(asked, tmp_path, SMALL)
    assert {"speed.csv", "speed.tex", "errors.svg"} <= {path.name for path in written}
    # What depends on the machine stands in the page, not in the README.
    assert "Median time of a case" in (tmp_path / "demo" / "report.html").read_text("utf-8")
    assert "Median time of a case" not in written[-1].read_text("utf-8")


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (({"name": "../above", "measure": "seconds"},), "is that of a file, not '../above'"),
        (({"measure": "seconds"}, {"measure": "seconds", "title": "Again"}), "give each a name"),
    ],
)
def test_no_output_leaves_its_folder_or_takes_the_place_of_another(entries, words):
    with pytest.raises(InputError, match=words):
        check_outputs(study(tables=entries))
