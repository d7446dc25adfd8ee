"""Settings that every test shares: no deadlines, the same examples each run, one thread."""

import warnings
from collections.abc import Iterator

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

settings.register_profile("sparsefit", deadline=None, derandomize=True)
settings.load_profile("sparsefit")

SECONDS = 0.01  # that a case takes of a study that runs `in_process`, as far as it is told


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Small matrices run faster on one thread, and identically."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies run without worker processes, for tests of what is before and after their work."""
    from sparsefit.study.run import flight_kind
    from sparsefit.study.run.execution import run_flight
    from sparsefit.study.run.outcome import Outcome

    def outcomes(study, jobs, processes, stop=None):
        for job in jobs:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # as in a worker
                events = list(run_flight(study, job.flight, [study.cells[i] for i in job.cells]))
            yield from ((event, SECONDS) for event in events if isinstance(event, Outcome))

    monkeypatch.setattr(flight_kind, "outcomes", outcomes)
