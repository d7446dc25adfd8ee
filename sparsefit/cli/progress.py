"""How far a run is: a bar on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from typing import Any

from sparsefit.cli.output import duration

PLAIN_SECONDS = 5.0
BAR = "{percentage:3.0f} % |{bar}| {n_fmt}/{total_fmt} cases, {elapsed} gone{postfix}"


class Bar:
    """A progress bar on stderr. tqdm draws; the time left is the caller's, who knows the cases."""

    def __init__(self) -> None:
        self._bar: Any = None

    def __call__(self, done: int, planned: int, left: float | None) -> None:
        """Show that ``done`` of ``planned`` cases are finished, with the seconds left if known."""
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(
                total=planned, initial=done, bar_format=BAR, file=sys.stderr, dynamic_ncols=True
            )
        self._bar.n = done
        self._bar.set_postfix_str(_left(done, planned, left), refresh=False)
        self._bar.refresh()

    def close(self) -> None:
        """Leave the last state on the screen."""
        if self._bar is not None:
            self._bar.close()


class Lines:
    """A line on stderr at the start, at the end, and at most every five seconds between."""

    def __init__(self) -> None:
        self._last = float("-inf")

    def __call__(self, done: int, planned: int, left: float | None) -> None:
        """Print how many of ``planned`` cases are done, with the seconds left, if it is time."""
        now = time.monotonic()
        if done < planned and now - self._last < PLAIN_SECONDS:
            return
        self._last = now
        time_left = _left(done, planned, left)
        print(
            f"{done}/{planned} cases, {100 * done // planned} %"
            f"{', ' + time_left if time_left else ''}",
            file=sys.stderr,
            flush=True,
        )

    def close(self) -> None:
        """Nothing to clear away."""


def _left(done: int, planned: int, left: float | None) -> str:
    if done == planned or left is None:
        return ""
    return f"about {duration(left)} left"
