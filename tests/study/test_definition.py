"""A study file is read as it was meant, or refused where it is wrong."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from sparsefit.errors import InputError
from sparsefit.study.flight_experiment import FlightExperiment
from sparsefit.study.study import Study

GOOD = """
name = "good"
question = "Which back-end is nearest?"
seed = 20201120

[flights]
count = 6
timescale = { linspace = [0.05, 1.0] }
length_scale = { uniform = [2.0, 10.0] }
response_time = 0.5
thrust_acceleration = [5.0, 3.0]
duration = 2.0
sample_rate = 100.0

[library]
lower = 2.0
upper = 10.0
step = 1.0

[[backends]]
name = "lasso"
alpha_fraction = [0.01, 0.1]

[[backends]]
name = "least-squares"
label = "literal"

[[protocols]]
name = "better"

[[protocols]]
name = "paper"
"derivative.method" = "forward"
"readout.length_scale" = "signed-sum"

[sweep]
"flights.velocity_noise" = [0.0, 0.5]

[split]
validate = 2
evaluate = 4

[run]
case_timeout = 30.0
tolerance = 1e-6
"""


def load(tmp_path: Path, text: str) -> FlightExperiment:
    path = tmp_path / "x.toml"
    path.write_text(text, encoding="utf-8-sig")  # with a byte order mark
    return Study.from_file(path).flights


def refusal(tmp_path: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "x.toml"))
    return message.removeprefix(str(tmp_path / "x.toml"))


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new, 1)


def test_reads_what_was_written(tmp_path: Path) -> None:
    study = load(tmp_path, GOOD)
    file = study.definition
    assert (file.name, file.seed, study.count) == ("good", 20201120, 6)
    assert (file.run.case_timeout, file.run.tolerance) == (30.0, 1e-6)
    assert study.count * len(study.points) == 6 * 2 * 2 * 3
    assert list(dict.fromkeys(c.backend.label for c in study.points)) == ["lasso", "literal"]
    bare = load(tmp_path, GOOD.replace('"derivative.method"', "derivative.method"))
    assert bare.protocols == study.protocols
    swept = GOOD.replace('"flights.velocity_noise"', "flights.velocity_noise")
    assert bare.hash == load(tmp_path, swept).hash == study.hash
    parts = [study.split(flight) for flight in range(6)]  # which are interleaved
    assert (parts.count("validate"), parts.count("evaluate")) == (2, 4)
    assert "evaluate" in parts[:3]
    assert "validate" in parts[3:]


def test_defaults(tmp_path: Path) -> None:
    study = load(tmp_path, GOOD.split("[[protocols]]")[0])
    assert study.protocols == {"default": {}}
    assert {study.split(i) for i in range(6)} == {"all"}
    assert (study.definition.run.case_timeout, study.definition.run.tolerance) == (60.0, 1e-8)


def test_an_example_message_to_the_letter(tmp_path: Path) -> None:
    message = refusal(tmp_path, changed("duration = ", "durration = "))
    assert message == ': [flights] key "durration" unknown: did you mean "duration"?'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed = 20201120", "sede = 1", 'key "sede" unknown: did you mean "seed"?'),
        ("seed = 20201120", "seed = -1", '"seed" must be at least 0'),
        ("seed = 20201120", f"seed = {'9' * 5000}", "more than 300 digits"),
        ("seed = 20201120", f"seed = 0x{'f' * 5000}", "more than 300 digits"),
        ("seed = 20201120", 'seed = 1\nkind = "flight"', 'did you mean "flights"?'),
        ('question = "Which back-end is nearest?"', "", '"question" missing'),
        ("question = ", "qestion = ", 'key "qestion" unknown: did you mean "question"?'),
        ('name = "good"', 'name = "../good"', "name must be 1 to 64"),
        ('name = "good"', 'name = ""', '"name" must be one non-empty line'),
        ("count = 6", "count = 0", '[flights] key "count" must be at least 1'),
        ("count = 6", "", '[flights] key "count" missing'),
        ("response_time = 0.5", "response_time = 0.5\ndropouts = 0.1", 'mean "lost_samples"?'),
        ("response_time = 0.5", "response_time = 0.5\nlost_samples = 2", "and at most 1, not 2"),
        ("duration = 2.0", "duration = -2.0", '"duration" must be above 0'),
        ("duration = 2.0", "duration = [1, 2]", '"duration" must be a number'),
        ("duration = 2.0", "", '"duration" missing: every flight needs it'),
        ("sample_rate = 100.0", "sample_rate = 1e9", "samples: keep it below 5000000"),
        ("{ uniform = [2.0, 10.0] }", "{ uniform = [10.0, 2.0] }", "range [10, 2] is empty"),
        ("{ uniform = [2.0, 10.0] }", "{ uniform = [2.0] }", "uniform takes two numbers"),
        ("{ uniform = [2.0, 10.0] }", "{ unifrom = [2, 3] }", 'did you mean "uniform"?'),
        ("{ uniform = [2.0, 10.0] }", "{ loguniform = [-1, 3] }", "must be above 0"),
        ("{ uniform = [2.0, 10.0] }", "{}", "exactly one of"),
        ("response_time = 0.5", "response_time = 0.5\nmean_velocity = 3", "exactly two of"),
        ("timescale = { linspace = [0.05, 1.0] }", "", "needs exactly two of"),
        ("response_time = 0.5", 'response_time = 0.5\nflow = "non"', 'did you mean "none"?'),
        ("response_time = 0.5", 'response_time = 0.5\nflow = "turbulence"',
         '"turbulence_ratio" missing'),
        ("[5.0, 3.0]", "5.0", '"thrust_acceleration" must be a pair'),
        ("response_time = 0.5", "drag = 1.0\nmeasurement_noise = [1, 1]\nvelocity_noise = 1",
         "say one thing: drop one of them"),
        ("response_time = 0.5", "thrust_turn = 2.0", "a flight without drag needs it"),
        ("response_time = 0.5", "drag = 0.2\nthrust_turn = 2.0", "missing: thrust_turn needs it"),
        ("step = 1.0", "step = 1.0\ncount = 4", "[library]"),
        ("step = 1.0", "stepp = 1.0", '[library] key "stepp" unknown: did you mean "step"?'),
        ("step = 1.0", 'target = "acceleratoin"', 'did you mean "acceleration"?'),
        ("[run]", '[online]\nwindow = 5\n[estimator]\nfree = ["wind"]\n[run]', "[online] this est"),
        ("[run]", '[estimator]\nfree = ["wnd"]\n[run]', '[estimator] unknown cause to free "wnd"'),
        ('"derivative.method"', '"derivative.methd"', 'did you mean "method"?'),
        ('"derivative.method"', '"derivatve.method"', 'did you mean "derivative.method"?'),
        ('name = "paper"', 'name = "better"', 'lists \'better\' twice'),
        ('name = "paper"\n', "", '[protocols] key "name" missing'),
        ('"derivative.method" = "forward"\n"readout.length_scale" = "signed-sum"\n', "",
         "[protocols] lists {} twice"),
        ('"derivative.method" =', '"flights.velocity_noise" = 1.0\n"derivative.method" =',
         "is in [sweep] too"),
        ("[0.0, 0.5]", "[]", '[sweep] key "flights.velocity_noise" must not be an empty list'),
        ("[0.0, 0.5]", "[0.5, 0.5]", "twice"),
        ("[0.0, 0.5]", "[0.0, -0.5]", "with flights.velocity_noise = -0.5: [flights]"),
        ("flights.velocity_noise", "flights.count", "of the whole study: set it in [flights]"),
        ("flights.velocity_noise", "velocity_noise", 'did you mean "flights.velocity_noise"?'),
        ('name = "lasso"', 'name = "laso"', 'did you mean "lasso"?'),
        ('name = "lasso"\n', "", '[backends] key "name" missing'),
        ("alpha_fraction = [0.01, 0.1]", "alpha_fraction = 2.0", "[backends] lasso"),
        ("alpha_fraction = [0.01, 0.1]", "alpha_fraction = [0.1, 0.1]", "twice"),
        ("alpha_fraction = [0.01, 0.1]", "alpha_fraction = [[0.1]]", "must be a number, text"),
        ("alpha_fraction = [0.01, 0.1]", "alfa_fraction = 0.1", "alpha_fraction"),
        ('name = "least-squares"\nlabel = "literal"', 'name = "lasso"\nalpha_fraction = 0.1',
         "listed twice"),
        *(('"literal"', f'"a{bad}b"', "control characters")
          for bad in ("\\u001b[31m", "\\u0007", "\\r", "\\u2028")),
        ("validate = 2", "validate = 3", "counts sum to 7, not to the 6"),
        ("tolerance = 1e-6", "tolerance = 1.0", "must be above 0 and below 1, not 1"),
        ("case_timeout = 30.0", "case_timeout = 0", "case_timeout\" must be above 0 [s], not 0"),
        ("[run]", "[run]\nmax_memory = 1", "at least 256 [MB]"),
        ("[run]", "[outputs]\ntables = nan\n[run]", "[outputs] tables and figures are names"),
        ("[run]", "[outputs]\ntables = []\n[run]", "must not be an empty list"),
        ("[run]", '[outputs.reference]\nname = "x"\ndeviation = [1]\n[run]', "must be 3 values"),
        ("[run]", '[outputs]\nscript = "no.py"\n[run]', "no such file beside x.toml"),
    ],
    ids=lambda text: text[-40:],
)  # fmt: skip
def test_refusals(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refusal(tmp_path, changed(old, new))


def test_not_toml_not_text(tmp_path: Path) -> None:
    for text, line in (("seed = = 3\n", 1), ("\n[flights\n", 2), ('name = "a', 1)):
        assert refusal(tmp_path, text).startswith(f":{line}: not TOML")
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        Study.from_file(tmp_path / "x.toml")


def test_too_many_cases_are_refused_with_their_number(tmp_path: Path) -> None:
    noises = ", ".join(str(i / 1000) for i in range(1000))
    text = changed("[0.0, 0.5]", f"[{noises}]").replace("count = 6", "count = 600")
    text = text.replace("evaluate = 4", "evaluate = 598")
    assert f"plans {600 * 2 * 1000 * 3} cases" in refusal(tmp_path, text)


def test_hash_is_of_the_content(tmp_path: Path) -> None:
    same = "# a comment\n" + changed("duration = 2.0", "duration   =   2")
    shown = changed("Which back-end", "Which solver")
    hashes = [load(tmp_path, text).hash for text in (GOOD, same, shown)]
    assert len(set(hashes)) == 1
    others = changed("20201120", "20201121"), changed("2.0, 10.0", "2.0, 9.0")
    hashes += [load(tmp_path, text).hash for text in others]
    assert len(set(hashes)) == 3


def test_settings_that_only_fit_together(tmp_path: Path) -> None:
    """A window of 3 is refused with the default order 4, not with the order the protocol sets."""
    text = changed("[sweep]", '[sweep]\n"derivative.window" = [3, 7]')
    assert "no window" in refusal(tmp_path, text)
    text = text.replace("[sweep]", '[derivative]\nmethod = "savgol"\n[sweep]')
    text = text.replace('"derivative.method" = "forward"', '"derivative.method" = "savgol"')
    assert "order" in refusal(tmp_path, text)
    text = text.replace('name = "better"', 'name = "better"\n"derivative.order" = 2')
    text = text.replace('"derivative.method" = "savgol"', '"derivative.order" = 1')
    assert len(load(tmp_path, text).points) == 2 * 4 * 3


@pytest.mark.parametrize("where", ["", '[[protocols]]\nname = "w"\nreadout.'])
def test_what_no_estimator_can_combine_is_refused_before_the_first_case(
    tmp_path: Path, where: str
) -> None:
    text = GOOD.split("[[protocols]]")[0] + '[readout]\nscales = "several"\n'
    assert "cannot part several" in refusal(tmp_path, f'{text}{where}mean_velocity = "paper"\n')


@pytest.mark.parametrize(
    ("bomb", "said"),
    [
        (".".join("a" * 5_000) + " = 1", "a key of more than 32 parts"),
        ("[" + ".".join("a" * 100_000) + "]", "a key of more than 32 parts"),
        ('x = { "a".' + ".".join("b" * 40_000) + " = 1 }", "a key of more than 32 parts"),
        ("x = " + "[" * 300 + "]" * 300, "nested too deeply"),
        ("x = " + "[" * 100_000, "nested too deeply"),
        ("x = " + "{ a = " * 500 + "1" + " }" * 500, "nested too deeply"),
        ("# " + "x" * 2_000_000, "more than 1 MB"),
        ("x = " + "9" * 900_000, "more than 300 digits"),
    ],
    ids=("key", "header", "inline", "list", "open", "tables", "size", "word"),
)
def test_bombs_are_refused_in_bounded_time(tmp_path: Path, bomb: str, said: str) -> None:
    (tmp_path / "x.toml").write_text(bomb, encoding="utf-8")
    began = time.process_time()
    with pytest.raises(InputError, match=said):
        Study.from_file(tmp_path / "x.toml")
    assert time.process_time() - began < 1.0
