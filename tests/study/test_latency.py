import json
import math

import pytest

from sparsefit.study.run.latency import LATENCY, Latency, measure, read_latency, write_latency
from sparsefit.study.spec.study import Study

STUDY = """
name = "small"
question = "Does it run?"
seed = 1
[flights]
count = 2
timescale = 0.5
length_scale = 4.0
response_time = 0.5
duration = 2.0
sample_rate = 50.0
[library]
lower = 3.0
upper = 5.0
step = 0.5
[readout]
refine = "none"
[[backends]]
name = "stlsq"
"""


@pytest.fixture
def study(tmp_path):
    (tmp_path / "small.toml").write_text(STUDY)
    return Study.load(tmp_path / "small.toml")


def test_one_candidate_is_timed_in_a_process_of_its_own(study):
    (latency,) = measure(study, {"a": study.cells}, 3).values()
    assert latency.flights == 3
    assert 0.0 < latency.median <= latency.p99 < 10.0
    assert 20.0 < latency.memory < 2000.0
    assert 0.0 <= latency.busy <= 1.0


def test_times_are_those_of_this_study_and_version_or_none(study, tmp_path):
    measured = {"a": Latency(0.1, 0.2, 90.0, 5), "b": Latency.failed()}
    write_latency(study, tmp_path, measured)
    assert read_latency(study, tmp_path) == measured
    assert math.isinf(read_latency(study, tmp_path)["b"].p99)
    content = json.loads((tmp_path / LATENCY).read_text())
    for key, value in (("study_hash", "other"), ("machine", {"sparsefit": "0"}), ("machine", [])):
        (tmp_path / LATENCY).write_text(json.dumps(content | {key: value}))
        assert read_latency(study, tmp_path) == {}
    (tmp_path / LATENCY).write_text("{")
    assert read_latency(study, tmp_path) == {}
