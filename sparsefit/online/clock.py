"""What following a flight takes: processor time of every sample and of every estimate.

Processor time, as another program may have the core in between. The first window warms up what is
worked out once, and does not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

import numpy as np
from threadpoolctl import threadpool_limits

from sparsefit.arrays import Array
from sparsefit.flight import Flight
from sparsefit.online.estimator import OnlineEstimator


@dataclass(frozen=True)
class Clocked:
    """Times of an online estimator along a flight.

    Args:
        samples: that the window held at the end.
        columns: of the library.
        nbytes: of memory for samples, rows and sums.
        updates: seconds of each sample (u,).
        estimates: seconds of each estimate (e,).
        answered: share of the estimates with status ``ok``.
    """

    samples: int
    columns: int
    nbytes: int
    updates: Array
    estimates: Array
    answered: float


def clocked(online: OnlineEstimator, flight: Flight, every: int, warm_up: float) -> Clocked:
    """Feed a flight to an online estimator on one thread, and take the time.

    Args:
        online: the estimator.
        flight: to follow.
        every: so many samples there is an estimate.
        warm_up: seconds of flight that do not count.
    """
    updates, estimates, answered, columns = [], [], [], 0
    rows = zip(
        flight.time.tolist(), flight.position.tolist(), flight.velocity.tolist(), strict=True
    )
    with threadpool_limits(1):
        for number, sample in enumerate(rows, 1):
            start = process_time()
            online.update(*sample)
            middle = process_time()
            counts = sample[0] - flight.time[0] > warm_up
            if counts:
                updates.append(middle - start)
            if number % every:
                continue
            middle = process_time()
            estimate = online.estimate()
            if counts:
                estimates.append(process_time() - middle)
                answered.append(estimate.status == "ok")
                columns = estimate.columns
    share = float(np.mean(answered)) if answered else 0.0
    return Clocked(
        online.samples, columns, online.nbytes, np.array(updates), np.array(estimates), share
    )
