"""Settings that every test shares: no deadlines, the same examples each run, one thread."""

import gc
import warnings
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

settings.register_profile("sparsefit", deadline=None, derandomize=True)
settings.load_profile("sparsefit")

gc.disable()  # until tests are collected: modules and tests stay, and need no search for waste

SECONDS = 0.01  # that a case takes of a study that runs `in_process`, as far as it is told


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Small matrices run faster on one thread, and identically."""
    with threadpool_limits(1):
        yield


def run_in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let studies run without worker processes until the patch is undone."""
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


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies run without worker processes, for tests of what is before and after their work."""
    run_in_process(monkeypatch)


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports have their pictures, with nothing in them, for tests of what is beside them."""
    from matplotlib.figure import Figure

    from sparsefit.study.report import pages

    blank = dict.fromkeys(pages.FIGURES.compares, lambda *_: Figure())
    monkeypatch.setattr(pages, "FIGURES", replace(pages.FIGURES, compares=blank))


@pytest.fixture
def not_laid_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are not laid out, which is half of their time, for tests of what panels show."""
    from sparsefit.study.report import figures

    monkeypatch.setattr(figures, "laid_out", lambda make: make())
