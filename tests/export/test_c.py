"""The exported C: it compiles without a word, runs clean, and says what its model says."""

import re
import shutil
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.export.layout import constants, ram
from sparsefit.export.measure import footprint
from sparsefit.export.package import TOLERANCE
from sparsefit.export.sheet import sheet
from sparsefit.export.source import body, header, in_comment
from sparsefit.export.work import estimate, update
from tests.export.boards import (
    SANITIZED,
    STRICT,
    compiled,
    fly,
    needs_cc,
    plan_of,
    ran,
    written,
)

FLIGHT = fly()
SAVGOL = sf.Derivative("savgol", window=7, order=3)
QUICK = (
    ("double", {}),
    ("float", {}),
    ("double", {"backend": "lasso", "refine": "none", "count": 6, "alpha_fraction": 0.2}),
)
LOCAL = (SAVGOL, sf.Derivative("central"), sf.Derivative("forward"), sf.Derivative("midpoint"))
ALL = [
    (real, {"backend": name, "refine": refine, "count": count, **more})
    for real in ("double", "float")
    for name, refine, count, more in (
        ("best-scale", "none", 20, {"derivative": LOCAL[0]}),
        ("best-scale", "variable-projection", 60, {"derivative": LOCAL[1]}),
        ("best-scale", "variable-projection", 60, {"derivative": LOCAL[2], "every": 2}),
        ("lasso", "none", 12, {"derivative": LOCAL[3], "alpha_fraction": 0.3}),
        ("lasso", "variable-projection", 30, {"derivative": LOCAL[0]}),
        ("stlsq", "none", 12, {"derivative": LOCAL[1], "unbias": False}),
        ("stlsq", "variable-projection", 30, {"derivative": LOCAL[2], "unbias": False}),
    )
] + [("double", {"backend": "stlsq", "refine": "none", "count": 12})]


def replayed(plan, folder, flight=FLIGHT, flags=(*STRICT, *SANITIZED)):
    """How many answers of the replay were ok; all must agree with the reference."""
    written(plan, flight, folder)
    program = compiled(folder, "sf_flow.c", "test/replay.c", flags=flags)
    tolerance = TOLERANCE[plan.real]
    code, out, err = ran(program, "test/flight.csv", "test/reference.csv", tolerance)
    assert code == 0, err
    return sum(line.split(",")[1] == "0" for line in out.splitlines())


@needs_cc
@pytest.mark.parametrize(
    ("real", "settings", "flags"),
    [
        ("double", QUICK[2][1], ()),
        ("float", {}, ()),
        pytest.param("double", {}, SANITIZED, marks=pytest.mark.slow),
    ],
)
def test_the_c_says_what_its_model_says(real, settings, flags, tmp_path):
    assert replayed(plan_of(real, **settings), tmp_path, flags=(*STRICT, *flags)) >= 6


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize(("real", "settings"), ALL)
def test_every_back_end_and_derivative_says_what_its_model_says(real, settings, tmp_path):
    assert replayed(plan_of(real, **settings), tmp_path) >= 4


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30, 34))
@pytest.mark.parametrize("real", ["double", "float"])
def test_other_flights_with_more_noise_and_a_gap(real, seed, tmp_path):
    flight = fly(seed, noise=0.5, duration=12.0)
    kept = np.r_[0:500, 540 : flight.samples]
    cut = sf.Flight(flight.time[kept], flight.position[kept], flight.velocity[kept], flight.vehicle)
    assert replayed(plan_of(real, count=60), tmp_path, cut) >= 4


@needs_cc
def test_a_reference_that_is_not_its_own_fails_the_replay(tmp_path):
    written(plan_of(refine="none", count=12), FLIGHT, tmp_path)
    reference = tmp_path / "test/reference.csv"
    lines = reference.read_text().splitlines()
    cells = lines[-1].split(",")
    cells[5] = repr(float(cells[5]) * (1 + 1e-6))
    reference.write_text("\n".join([*lines[:-1], ",".join(cells)]) + "\n")
    program = compiled(tmp_path, "sf_flow.c", "test/replay.c")
    code, _, err = ran(program, "test/flight.csv", "test/reference.csv", 1e-9)
    assert code == 1
    assert "1 beyond 1e-09" in err
    assert ran(program, "test/flight.csv")[0] == 0
    assert ran(program, "nowhere.csv")[0] == 2


@needs_cc
@pytest.mark.parametrize(
    ("real", "settings"),
    [*QUICK, ("float", {"backend": "stlsq", "count": 7, "unbias": False})],
)
def test_the_state_is_as_large_as_the_header_says(real, settings, tmp_path):
    plan = plan_of(real, **settings)
    source = header(plan, sheet(plan, "a.json", None))
    size = "#include <sf_flow.h>\ntypedef char exact[(sizeof(sf_flow) == SF_RAM_BYTES) ? 1 : -1];\n"
    (tmp_path / "sf_flow.h").write_text(source)
    (tmp_path / "size.c").write_text(size)
    compiled(tmp_path, "size.c", flags=("-std=c99", "-fsyntax-only"))
    assert f"#define SF_RAM_BYTES {ram(plan)}u" in source


def beside(plan, folder, program):
    """The C of a plan, and a program of this folder that uses it."""
    (folder / "sf_flow.h").write_text(header(plan, sheet(plan, "a.json", None)))
    (folder / "sf_flow.c").write_text(body(plan))
    shutil.copy(Path(__file__).parent / program, folder)


@needs_cc
def test_every_status_is_told_and_what_is_refused_changes_nothing(tmp_path):
    beside(plan_of("float", count=5), tmp_path, "states.c")
    program = compiled(tmp_path, "sf_flow.c", "states.c", flags=("-std=c99", "-Wall", "-Wextra"))
    assert ran(program)[0] == 0


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize(
    ("real", "settings"),
    [
        ("float", {"count": 25}),
        ("double", {"backend": "lasso", "refine": "none", "count": 4, "derivative": LOCAL[1]}),
        ("double", {"backend": "stlsq", "refine": "none", "count": 4, "derivative": LOCAL[3]}),
    ],
)
def test_odd_samples_break_nothing(real, settings, tmp_path):
    beside(plan_of(real, **settings), tmp_path, "odd_samples.c")
    flags = ("-std=c99", *SANITIZED, "-fsanitize=float-cast-overflow")
    code, out, err = ran(compiled(tmp_path, "sf_flow.c", "odd_samples.c", flags=flags))
    assert code == 0, err
    assert sum(map(int, out.split())) == 12 * 60


@needs_cc
@pytest.mark.slow
def test_a_million_samples_in_float_are_those_in_double(tmp_path):
    answers = []
    for real in ("double", "float"):
        folder = tmp_path / real
        folder.mkdir()
        settings = {"count": 60, "derivative": sf.Derivative("forward")}
        beside(plan_of(real, **settings), folder, "long_flight.c")
        program = compiled(folder, "sf_flow.c", "long_flight.c", flags=(*STRICT, "-O2"))
        answers.append([float(word) for word in ran(program)[1].split()])
    double, single = answers
    assert double[:2] == single[:2] == [0, 999_999]
    assert double[2:] == pytest.approx([15.0, 4.2], rel=1e-3)
    assert single[2:] == pytest.approx(double[2:], rel=1e-5)


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler here")
@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"count": 40},
        {"refine": "none", "count": 12, "derivative": sf.Derivative("forward")},
        {"backend": "lasso", "refine": "none", "count": 4},
        {"backend": "stlsq", "count": 4, "derivative": sf.Derivative("central")},
    ],
)
def test_operations_are_counted_right(settings, tmp_path):
    plan = plan_of(**settings)
    beside(plan, tmp_path, "counting.cpp")
    source = tmp_path / "sf_flow.c"  # as if no descent came to its end before its last step
    source.write_text(re.sub(r"SF_END SF_R\(.*?\)", "SF_END SF_R(-1)", source.read_text()))
    sf.write_flight(FLIGHT, tmp_path / "flight.csv")
    program = compiled(tmp_path, "counting.cpp", flags=("-w",), compiler="c++")
    counted = {"update": set(), "estimate": set(), "before": set()}
    for line in ran(program, "flight.csv")[1].splitlines():
        what, *numbers = line.split()
        counted[what].add(tuple(map(int, numbers)))
    assert counted["before"] == {(0, 0, 0, 0, 0)}
    assert {astuple(update(plan, fold=False)), astuple(update(plan))} <= counted["update"]
    assert max(map(sum, counted["update"])) == sum(astuple(update(plan)))
    most = np.array(astuple(estimate(plan)))
    answers = np.array(sorted(counted["estimate"]))
    assert (answers <= most).all()
    if plan.columns == 0:  # the others end when they have converged
        assert answers.max(axis=0).sum() > 0.7 * most.sum()
    if plan.columns == 0 and not plan.refined:
        assert (answers[-1] == most).all()


@needs_cc
def test_the_footprint_is_what_the_compiler_says():
    plans = [plan_of("float", refine="none", count=count) for count in (10, 200)]
    first, second = (
        footprint({"sf_flow.h": header(plan, sheet(plan, "", None)).encode(),
                   "sf_flow.c": body(plan).encode()}, "cc")
        for plan in plans
    )  # fmt: skip
    tables = [constants(plan) for plan in plans]
    assert tables[1] - tables[0] == 190 * 4
    assert second.flash - first.flash == pytest.approx(190 * 4, abs=64)
    assert 200 < first.stack < 20_000


def test_five_tunables_at_most_and_no_other_library():
    for real, settings in QUICK:
        plan = plan_of(real, **settings)
        source = header(plan, sheet(plan, "a.json", None)) + body(plan)
        assert 1 <= len(re.findall(r"#ifndef SF_(?!FLOW_H)", source)) <= 5
        included = set(re.findall(r"#include\s+(\S+)", source))
        assert included == {'"sf_flow.h"', "<math.h>", "<stddef.h>", "<stdint.h>"}
        assert not re.search(r"\b(malloc|calloc|free|goto|alloca)\b", source)
        assert "$" not in source
        assert max(map(len, source.splitlines())) <= 110


def test_what_stands_in_a_comment_cannot_end_it():
    assert in_comment('*/ int x; /* "a\\') == '* / int x; / * "a/'
    assert in_comment("**/") == "** /"
    assert in_comment("a\nb\x1b[31m \u2028 ü ??/") == "a b?[31m ? ? ?/"
    assert len(in_comment("x" * 500)) == 90
