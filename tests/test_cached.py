"""The property that is worked out once, and never under a lock that other instances wait for."""

import threading
from concurrent.futures import ThreadPoolExecutor

from sparsefit.cached import cached_property


class Slow:
    def __init__(self, meeting):
        self.meeting, self.calls = meeting, 0

    @cached_property
    def value(self):
        self.calls += 1
        self.meeting.wait(timeout=10)  # breaks unless both instances are inside at once
        return self.calls


def test_it_is_worked_out_once_and_kept_in_the_instance():
    one = Slow(threading.Barrier(1))
    assert (one.value, one.value, one.calls) == (1, 1, 1)


def test_two_instances_are_worked_out_at_the_same_time():
    both = [*map(Slow, [threading.Barrier(2)] * 2)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda each: each.value, both)) == [1, 1]
