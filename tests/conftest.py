"""Settings that every test shares: no deadlines, the same examples each run, one thread."""

import gc
from collections.abc import Iterator

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

settings.register_profile("sparsefit", deadline=None, derandomize=True)
settings.load_profile("sparsefit")

gc.disable()  # until tests are collected: modules and tests stay, and need no search for waste


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Small matrices run faster on one thread, and identically."""
    with threadpool_limits(1):
        yield
