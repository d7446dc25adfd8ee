"""Flights of a study that are estimated together: nested, bounded as one, by identity others."""

import numpy as np

from sparsefit.study.run.execution import fly
from sparsefit.study.spec.identity import identities
from sparsefit.study.spec.study import Study
from sparsefit.uncertainty.bound import cramer_rao

TEXT = """
name = "together"
question = "How many?"
seed = 5
[flights]
count = 2
mean_velocity = 10.0
length_scale = 4.0
response_time = 0.5
duration = 2.0
sample_rate = 50.0
process_noise = 1.0
{more}
[[backends]]
name = "best-scale"
{sweep}
"""


def study(tmp_path, more="", sweep=""):
    path = tmp_path / "together.toml"
    path.write_text(TEXT.format(more=more, sweep=sweep))
    return Study.load(path)


def test_more_flights_hold_the_fewer_and_are_bounded_together(tmp_path):
    swept = study(tmp_path, sweep='[sweep]\n"flights.together" = [1.0, 3.0]')
    (one, least), (three, less) = (fly(swept, 1, swept.draw(1, cell)) for cell in swept.cells)
    assert (len(one), len(three)) == (1, 3)
    np.testing.assert_array_equal(one[0].position, three[0].position)
    assert len({flight.position[0, 0] for flight in three}) == 3
    assert all(flight.flow is None for flight in three)
    draw = swept.draw(1, swept.cells[1])
    every = np.concatenate([flight.position for flight in three])
    expected = cramer_rao(every, draw.flow, draw.vehicle, process_noise=1.0, model="semiparametric")
    assert less.bound == expected
    assert less.bound.length_scale < least.bound.length_scale


def test_a_case_of_one_flight_is_what_it_was_and_others_are_others(tmp_path):
    plain, two, three = (
        identities(study(tmp_path, more))[0] for more in ("", "together = 2", "together = 3")
    )
    assert len({plain, two, three}) == 3
