"""The Cramer-Rao bound: the information of a log at the true model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.smoother import Ascent, Smoothing, inverted


def bound(
    logs: FlightLog | Sequence[FlightLog],
    model: Model | Sequence[Model],
    states: Sequence[Array] | None = None,
) -> Array:
    """Return the Cramer-Rao bound of the free parameters (p, p), levels as they are.

    Args:
        logs: the times of readings and which are missing; their values do not matter where
            `states` are given.
        model: the true model of all logs, or of each.
        states: the true positions and velocities (m, 4) at the rows of each log; without them the
            trajectories are smoothed with the parameters known.

    Raises:
        InputError: if the logs do not see a free parameter.
    """
    records = (logs,) if isinstance(logs, FlightLog) else tuple(logs)
    models = (model,) * len(records) if isinstance(model, Model) else tuple(model)
    if states is None:
        known = tuple(each.known(*each.names) for each in models)
        search = Ascent(records, known, (), Smoothing())
        end = search.posterior(None).state
        tracks = [(nodes.time, track) for nodes, track in zip(end.nodes, end.tracks, strict=True)]
    else:
        search = Ascent(records, models, (), Smoothing())
        tracks = [
            (log.time - search.origin[2],
             np.asarray(each, dtype=np.float64)[:, :4] - [*search.origin[:2], 0.0, 0.0])
            for log, each in zip(records, states, strict=True)
        ]  # fmt: skip
    search = Ascent(records, models, (), Smoothing())
    step = search.step(search.along(tracks))
    covariance, weak = inverted(step.information, search.settings.dependent)
    if len(weak):
        names = ", ".join(search.names[j] for j in weak)
        raise InputError(f"the log does not see all of {names}: there is no bound")
    return covariance
