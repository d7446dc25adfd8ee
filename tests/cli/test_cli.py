"""The verbs on flights: what they print, what they write, and how they refuse."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from sparsefit.cli import main
from sparsefit.cli.terminal import rows
from sparsefit.estimator.estimator import Estimator
from sparsefit.flight.flow import ShapedCells, SuperposedFlow
from sparsefit.flight.waves import Turbulence
from sparsefit.logs import read_flight, write_flight
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.study import draw
from tests.cli.verbs import refused, run

SIMULATE = ("simulate", "--mean-velocity", "15.43", "--length-scale", "4.21", "--seed", "7")
COARSE = ("--grid-lower", "3.2", "--grid-upper", "5.2")
PAPER = ("--set", "readout.refine=none")


@pytest.fixture
def flight():
    assert main([*SIMULATE, "--duration", "5", "-o", "flight.csv"]) == 0
    return "flight.csv"


@pytest.mark.parametrize("name", ["flight.csv", "flight.parquet"])
def test_simulate_writes_the_flight_it_was_asked_for(capsys, name):
    options = ("--response-time", "0.25", "--thrust-acceleration", "-1e-3", "3")
    options += ("--initial-position", "1", "2")
    code, out, _ = run(capsys, *SIMULATE, *options, "--duration", "1", "-o", name)
    assert code == 0
    assert out.startswith(f"{name}: 101 samples over 1 s")
    again = ("--duration", "2", "-o", name, "--force", "--json")
    found = json.loads(run(capsys, *SIMULATE, *options, *again)[1])
    assert (found["output"], found["samples"], found["response_time"]) == (name, 201, 0.25)
    flight = read_flight(name)
    assert flight.samples == 201
    assert flight.flow.mean_velocity == 15.43
    assert flight.vehicle.response_time == 0.25
    assert flight.vehicle.thrust_acceleration == (-1e-3, 3.0)
    assert flight.position[0].tolist() == [1.0, 2.0]


def test_a_file_or_a_link_is_not_overwritten_wherever_it_leads(capsys, flight):
    os.symlink("nowhere.csv", "dangling.csv")
    os.symlink("loop.csv", "loop.csv")
    before = Path(flight).read_bytes()
    for name in (flight, "dangling.csv", "loop.csv"):
        assert f"{name} exists; add --force" in refused(capsys, *SIMULATE, "-o", name)
        assert os.path.islink(name) == (name != flight)
    assert Path(flight).read_bytes() == before
    os.mkfifo("pipe.csv")
    assert "is no regular file" in refused(capsys, *SIMULATE, "--force", "-o", "pipe.csv")


def test_simulate_flies_through_what_it_is_told(capsys, monkeypatch):
    flying = Mock(wraps=draw.simulate_flight)
    monkeypatch.setattr(draw, "simulate_flight", flying)
    options = ("--heading", "0.3", "--aspect", "1.2", "--angle", "1.4", "--offset", "1", "2")
    moving = ("--drift-ratio", "0.1", "--drift-direction", "0", "--wind", "0", "2")
    moving += ("--swell", "0.2", "--swell-period", "9")
    gusts = ("--turbulence-ratio", "0.1", "--turbulence-length", "8", "--turbulence-memory", "3")
    short = ("--turbulence-spectrum", "von-karman", "--duration", "0.5", "-o", "flight.csv")
    assert run(capsys, *SIMULATE, *options, *moving, *gusts, *short)[0] == 0
    cells = ShapedCells(
        15.43, (4.21, 1.2 * 4.21), 0.3, 1.4, (1.0, 2.0), (0.1 * 15.43, 0.0), 0.2, 9.0
    )  # fmt: skip
    gusty = Turbulence(0.1 * 15.43, 8.0, 3.0, "von-karman", 7)
    assert flying.call_args.args[0] == SuperposedFlow((cells, gusty), (0.0, 2.0))
    assert read_flight("flight.csv").samples == 51


def test_simulate_spoils_the_log(capsys):
    run(capsys, *SIMULATE, "--duration", "2", "-o", "clean.csv")
    faults = ("--outliers", "0.1", "--outlier-size", "5", "--jumps", "1", "--jump-size", "3")
    faults += ("--gaps", "2", "--gap-duration", "0.3")
    code, out, _ = run(capsys, *SIMULATE, "--duration", "2", *faults, "-o", "log.csv")
    assert code == 0
    clean, log = read_flight("clean.csv"), read_flight("log.csv")
    assert log.samples < clean.samples == 201
    assert f"log.csv: {log.samples} samples" in out
    kept = np.isin(clean.time, log.time)
    off = np.hypot(*(log.velocity - clean.velocity[kept]).T)
    assert off[off > 1e-9] == pytest.approx(5.0)
    wandering = ("--position-wander", "0.2", "--time-jitter", "0.3")
    assert run(capsys, *SIMULATE, "--duration", "2", *wandering, "-o", "late.csv")[0] == 0
    assert np.ptp(np.diff(read_flight("late.csv").time)) > 0.005


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--turbulence-ratio", "1"), "--turbulence-length missing: --turbulence-ratio needs it"),
        (("--turbulence-spectrum", "dreyden"), "'dreyden': did you mean \"dryden\"?"),
        (("--duration", "5min"), '"5min" is not a number; give it in s, without the unit'),
        (("--duration", "1e9"), "--duration at this --sample-rate is 1e+11 samples"),
        (("--thrust-acceleration", "5"), "argument --thrust-acceleration: "),
        (("--thrust", "5"), 'did you mean "--thrust-acceleration"?'),
        (("--sed", "1"), '--sed 1: did you mean "--seed"?; see sparsefit simulate --help'),
        (("-o", "flight.txt"), 'unknown file type ".txt"'),
        (("-o", "nowhere/flight.csv"), "nowhere is no folder; make it first"),
        (("-o", ""), "the name of the file to write is empty"),
        (("--jumps", "1e9"), "jumps: 1000000000 in 1001 samples"),
    ],
)
def test_simulate_refuses(capsys, options, words):
    output = () if "-o" in options else ("-o", "flight.csv")
    assert words in refused(capsys, *SIMULATE, *options, *output)


def test_the_command_alone_prints_its_help(capsys):
    code, out, err = run(capsys)
    assert (code, err) == (0, "")
    assert out.startswith("usage: sparsefit")


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_every_verb(capsys, shell):
    code, out, _ = run(capsys, "completion", shell)
    assert code == 0
    for name in ("simulate", "estimate", "study", "select", "export", "backends"):
        assert name in out


def test_estimate_prints_standard_errors_and_intervals(capsys):
    path, noise = "noisy.csv", ("--velocity-noise", "0.1", "--position-noise", "0.02")
    assert run(capsys, *SIMULATE, *noise, "-o", path)[0] == 0
    code, out, _ = run(capsys, "estimate", path)
    assert code == 0
    line = next(line for line in out.splitlines() if line.startswith("length scale"))
    value, spread, low, high = (float(n) for n in re.findall(r"\d+\.\d+", line))
    assert low < 4.21 < high
    assert high - value == pytest.approx(1.96 * spread, rel=0.02)
    out = run(capsys, "estimate", path, "--json")[1]
    assert json.loads(out)["uncertainty"]["length_scale"] == pytest.approx(spread, rel=0.1)
    assert "±" not in run(capsys, "estimate", path, *PAPER)[1]


def test_estimate_prints_parameters_with_units_or_one_object(capsys, flight):
    code, out, err = run(capsys, "estimate", flight)
    assert (code, err) == (0, "")
    for words in (" m/s  ± ", "status                ok", "group-lasso  alpha_fraction=0.1"):
        assert words in out
    code, out, _ = run(capsys, "estimate", flight, "--json")
    found = json.loads(out)
    assert code == 0
    assert found["length_scale"] == pytest.approx(4.21, abs=0.11)
    assert found["timescale"] == pytest.approx(found["length_scale"] / found["mean_velocity"])
    assert (found["status"], found["reason"], found["backend"]) == ("ok", "", "group-lasso")
    assert found["certificate"]["kind"] == "duality_gap"
    assert found["weights_by_scale"][0] == [1.0, 0.0]


def test_estimate_that_is_not_ok_exits_1_and_is_printed_all_the_same(capsys, flight):
    options = ("--backend", "stlsq", "--setting", "threshold=50", *COARSE)
    code, out, err = run(capsys, "estimate", flight, *options, "--json")
    assert code == 1
    assert json.loads(out)["status"] == "unidentifiable"
    assert json.loads(out)["length_scale"] is None
    assert err == ""
    code, out, _ = run(capsys, "estimate", flight, *options)
    assert code == 1
    assert "length scale   L_w            – m" in out


def test_settings_as_toml_scalars_and_options_reach_the_estimator(capsys, flight):
    words = ("alpha_fraction=0.2", "separate=true", 'group_weights="sqrt-size"', "solver=clarabel")
    pairs = ("derivative.method=savgol", "derivative.window=7", "derivative.order=3")
    pairs += ("library.target=acceleration", "readout.length_scale=absolute-sum")
    pairs += ("readout.mean_velocity=paper",)
    options = [item for word in words for item in ("--setting", word)]
    options += [item for pair in pairs for item in ("--set", pair)]
    grid = ("--grid-lower", "3", "--grid-upper", "5", "--grid-step", "0.5")
    code, out, _ = run(capsys, "estimate", flight, *grid, *options, "--json")
    found = json.loads(out)
    assert code == 0
    assert [scale for scale, _ in found["weights_by_scale"]] == [3.0, 3.5, 4.0, 4.5, 5.0]
    assert found["samples"] == 501 - 6
    settings = {"alpha_fraction": 0.2, "separate": True, "group_weights": "sqrt-size"}
    assert found["settings"].items() >= {**settings, "solver": "clarabel"}.items()


def test_vehicle_of_the_command_line_replaces_only_what_it_names(capsys, flight):
    _, out, _ = run(capsys, "estimate", flight, *COARSE, *PAPER, "--thrust-ax", "1")
    assert "response time 0.5 s, thrust (1, 3) m/s^2" in out
    text, bare = Path(flight).read_text(), "bare.csv"
    Path(bare).write_text(re.sub("^#.*\n", "", text, flags=re.MULTILINE))
    for options in ((), ("--thrust-ax", "1")):
        line = refused(capsys, "estimate", bare, *options)
        assert "no vehicle: no response time; add" in line
        assert "--response-time" in line
    _, out, _ = run(capsys, "estimate", bare, *COARSE, *PAPER, "--response-time", "0.5")
    assert "response time 0.5 s, thrust (0, 0) m/s^2" in out


def test_estimator_file_is_used(capsys, flight):
    estimator = Estimator(library=Library(LengthScaleGrid(3.0, 5.0, 1.0)), backend="lasso")
    Path("estimator.json").write_text(estimator.to_json())
    _, out, _ = run(capsys, "estimate", flight, "--estimator", "estimator.json", "--json")
    assert json.loads(out)["backend"] == "lasso"
    assert json.loads(out)["columns"] == 24
    err = refused(capsys, "estimate", flight, "--estimator", "estimator.json", "--grid-step", "7")
    assert "--grid-step and --estimator cannot both be given" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--backend", "laso"), 'unknown back-end "laso": did you mean "lasso"?'),
        (("--setting", "alpha_fraction"), "is not key=value"),
        (("--set", "derivative.method=savgol", "--set", "derivative.window=5001"), "does not fit"),
        (("--set", "library.target=flow"), "--set library.target has unknown value 'flow' (known"),
        (("--set", "library.famly=1"), '--set library.famly unknown: did you mean "family"?'),
        (("--set", "libary.step=1"), '--set libary unknown: did you mean "library"?'),
        (("--unknown", "wind", "thrust_acceleration"), "cannot both be unknown"),
        (("--estimator", "flight.csv"), "not an estimator"),
        ((".",), "cannot read .: it is a folder; give a file in it"),
        (("--plot", "/dev/null"), "cannot write /dev/null: it is no regular file"),
    ],
)
def test_estimate_refuses_an_option(capsys, flight, options, words):
    assert words in refused(capsys, "estimate", flight, *options)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (MemoryError, 2, "sparsefit: error: not enough memory; use fewer length scales or samples"),
        (ModuleNotFoundError("no finufft"), 2, "sparsefit: error: no finufft: install"),
        (KeyboardInterrupt, 130, "stopped"),
    ],
)
def test_what_an_estimate_raises_ends_in_a_line(capsys, flight, monkeypatch, error, code, words):
    monkeypatch.setattr(Estimator, "estimate", Mock(side_effect=error))
    ended, out, err = run(capsys, "estimate", flight)
    assert (ended, out) == (code, "")
    assert err.strip().startswith(words)
    assert err.strip().count("\n") == 0
    monkeypatch.setattr(Estimator, "estimate", Mock(side_effect=ZeroDivisionError))
    with pytest.raises(ZeroDivisionError):  # a bug of ours is not dressed up as bad input
        main(["estimate", flight])


def test_backends_are_listed_with_settings_and_certificate(capsys):
    code, out, _ = run(capsys, "backends")
    assert code == 0
    assert re.search(
        r"name +group-lasso\nsummary +1/\(2m\) \|Y - ZV\|\^2 \+ alpha sum_g omega_g", out
    )
    assert re.search(r"certificate +duality_gap\nsettings alpha_fraction +0.1", out)
    assert "clarabel" in out.partition("solvers")[2]
    for argv in (("backends", "--json"), ("backends", "list", "--json")):
        listed = json.loads(run(capsys, *argv)[1])
        assert [one["name"] for one in listed["backends"]][:2] == ["least-squares", "stlsq"]
        assert listed["solvers"] == ["clarabel"]


@pytest.mark.parametrize("name", ["least-squares", "stlsq", "lasso", "group-lasso"])
def test_every_back_end_passes_its_check(capsys, name):
    code, out, _ = run(capsys, "backends", "check", name)
    assert code == 0
    assert re.match(rf"backend +{name}\nstatus +ok\n", out)
    code, out, _ = run(capsys, "backends", "--json", "check", name)
    assert json.loads(out)["length_scale"] == pytest.approx(4.0, rel=1e-6)
    assert name != "stlsq" or run(capsys, "backends", "check", name, "--setting", "threshold=50")[0]


VERBS = ("simulate", "estimate", "study", "study check", "study plan", "study run", "study status",
         "study errors", "study show", "study report", "study compare", "study merge",
         "select", "export", "backends", "backends list", "backends check",
         "completion")  # fmt: skip


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example_and_json(capsys, verb):
    code, out, _ = run(capsys, *verb.split(), "--help")
    assert code == 0
    assert re.search(rf"example:\n  .*sparsefit {verb.split()[0]}", out)
    assert "--json" in out


@pytest.mark.parametrize("argv", ["estimat", "study rum", "backends foo", "estimate"])
def test_bad_usage_is_one_line(capsys, argv):
    line = refused(capsys, *argv.split())
    assert "--help" in line
    assert ('did you mean "estimate"?' in line) == (argv == "estimat")


def test_help_needs_no_numpy():
    script = (
        "import sys; from sparsefit.cli import parser; parser().format_help(); "
        "sys.exit('numpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0


@pytest.mark.parametrize("while_imported", [True, False])
def test_ctrl_c_ends_in_a_line_or_finds_all_done(while_imported):
    cli = "__getattr__ = lambda name: exec('signal.raise_signal(signal.SIGINT)'); "
    script = (
        "import signal, sys, types; from sparsefit.__main__ import main; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "
        "cli = sys.modules['sparsefit.cli'] = types.ModuleType('cli'); "
        f"cli.{cli if while_imported else 'main = lambda: 0; '}"
        "code = main(); signal.raise_signal(signal.SIGINT); sys.exit(code)"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == ((130, "\nstopped\n") if while_imported else (0, ""))


def test_a_reader_that_leaves_early_is_no_error(flight):
    program = "import sys; from sparsefit.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "estimate", flight, "--json"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait() == 141


def test_streams_that_are_closed_are_no_traceback(flight, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["estimate", flight]) == 0
    assert main(["estimate", "absent.csv"]) == 2


def test_repairs_are_told_and_can_be_left_out(capsys, flight):
    clean = read_flight(flight)
    velocity = clean.velocity.copy()
    velocity[[100, 300]] += 5.0
    write_flight(replace(clean, velocity=velocity), "dirty.csv")
    _, out, _ = run(capsys, "estimate", "dirty.csv", *COARSE)
    assert re.search(r"^repaired +2 outliers replaced$", out, re.MULTILINE)
    _, out, _ = run(capsys, "estimate", "dirty.csv", "--json", *COARSE)
    assert json.loads(out)["repairs"]["outliers"] == 2
    kept = ("--set", "derivative.repair=false")
    assert "repaired" not in run(capsys, "estimate", "dirty.csv", *kept, *COARSE)[1]


def test_a_long_reason_is_folded_on_a_terminal_alone(monkeypatch):
    pairs = [("status", "error"), ("reason", " ".join(["samples are too few"] * 9))]
    assert [len(line) for line in rows(pairs)] == [13, 187]
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "60")
    folded = "\n".join(rows(pairs)).splitlines()
    assert max(map(len, folded)) <= 60
    assert all(line.startswith(" " * 8) for line in folded[2:])
    assert " ".join(folded).split() == " ".join(map(" ".join, pairs)).split()
