"""Plug-ins are listed and checked in processes of their own: they cannot end or hang ours."""

from __future__ import annotations

import json
import sys

import pytest

from sparsefit import backends
from sparsefit.cli import main
from sparsefit.cli.verb_backends import faults
from sparsefit.errors import InputError
from sparsefit.regression.backend import plugins
from sparsefit.study.study import Study
from tests.problems import regular

GOOD = """
import numpy as np
from dataclasses import dataclass
from typing import ClassVar
from sparsefit.regression.backend import Solution


def answer(problem):
    return np.linalg.lstsq(problem.theta, problem.target, rcond=None)[0]


@dataclass(frozen=True)
class Good:
    name: ClassVar[str] = "good"
    certificate_kind: ClassVar[str] = "fixed_point"
    deed: str = ""

    def solve(self, problem):
        if self.deed == "random":
            shape = (problem.columns, problem.targets)
            return Solution(100.0 * np.random.default_rng().standard_normal(shape))
        if self.deed == "hang":
            import time
            time.sleep(600)
        if self.deed == "raise":
            raise ZeroDivisionError("why")
        if self.deed in ("zeros", "worse"):
            scale = -1.0 if self.deed == "worse" else 0.0
            return Solution(scale * answer(problem))
        return Solution(answer(problem))

    def next_weights(self, problem, weights):
        return answer(problem)
"""


@pytest.fixture(scope="module", autouse=True)
def plug_ins(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plug")
    (folder / "well_behaved.py").write_text(GOOD)
    (folder / "leaves.py").write_text("import sys\nsys.exit(0)\n")
    (folder / "dies.py").write_text("import os\nos.abort()\n")
    info = folder / "plug-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: plug\nVersion: 1.0\n")
    places = "good = well_behaved:Good\nleaves = leaves:Thing\ndies = dies:Thing\n"
    (info / "entry_points.txt").write_text(f"[sparsefit.backends]\n{places}")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        plugins.cache_clear()
        yield
    plugins.cache_clear()


def test_plug_ins_that_end_their_process_are_listed_with_it(capfd):
    assert main(["backends", "list", "--json"]) == 0
    listed = {one["name"]: one for one in json.loads(capfd.readouterr().out)["backends"]}
    assert listed["good"]["settings"] == {"deed": ""}
    assert "SystemExit: 0" in listed["leaves"]["error"]
    assert "died of SIGABRT" in listed["dies"]["error"]
    assert "error" not in listed["lasso"]


WRONG = "it says ok of an answer that is not: fixed_point"
POOR = "its weights fit the target worse than zeros do"
TWICE = "it answers the same problem differently the second time: solve must be pure"


@pytest.mark.parametrize(
    ("deed", "fault"),
    [
        ("", []),
        ("random", [TWICE, POOR]),
        ("zeros", [WRONG]),
        ("worse", [WRONG, POOR]),
        ("raise", ["raises ZeroDivisionError: why"]),
    ],
)
def test_what_breaks_the_contract_is_found(deed, fault):
    found = faults(backends.get("good", deed=deed), regular())
    assert [one[: len(other)] for one, other in zip(found, fault, strict=True)] == fault


def test_check_of_a_plug_in(capfd):
    assert main(["backends", "check", "good", "--json", "--setting", "deed=random"]) == 1
    found = json.loads(capfd.readouterr().out)
    assert (found["backend"], len(found["faults"])) == ("good", 2)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["good", "--setting", "deed=hang", "--timeout", "1"], "took longer than 1 s"),
        (["lazzo"], 'did you mean "lasso"?'),
        (["lasso", "--timeout", "-1"], "--timeout must be"),
    ],
)
def test_what_ends_or_hangs_a_check_is_told_by_name(capfd, argv, words):
    assert main(["backends", "check", *argv]) == 2
    assert words in capfd.readouterr().err


def test_a_study_of_problems_loads_a_plug_in_elsewhere(tmp_path):
    path = tmp_path / "s.toml"
    text = 'name = "s"\nkind = "problems"\nquestion = "?"\n[[problems]]\ngenerator = "wide"\n'
    path.write_text(f'{text}[[backends]]\nname = "good"\n')
    assert Study.from_file(path).plan()["solver"].tolist() == ["good"]
    path.write_text(f'{text}[[backends]]\nname = "dies"\n')
    with pytest.raises(InputError, match="died of SIGABRT"):
        Study.from_file(path)
    assert "dies" not in sys.modules
    assert "leaves" not in sys.modules
