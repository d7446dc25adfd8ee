"""Score tests and bounds: the information of a log, at the optimum or at the truth.

One forward pass carries the sensitivities by all elements that any candidate moves. With the score
b and the information J of the free parameters a and the candidates c, a group of candidates gains

    2 ln(likelihood ratio) = s' (J_cc - J_ca J_aa^-1 J_ac)^-1 s,    s = b_c - J_ca J_aa^-1 b_a

(Rao's test), and its step from the present value is the inverse times s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.likelihood.model import Model, StateSpace
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import Posterior
from sparsefit.likelihood.smoother import Search, Smoothing, inverted
from sparsefit.likelihood.trellis import Pass


@dataclass(frozen=True, eq=False)
class Gain:
    """The score test of a group of candidates.

    Args:
        gain: 2 ln(likelihood ratio) by which the group should raise the likelihood.
        freedom: the number of directions that the group adds.
        step: from the present values to the best ones (c,), log after log.
        error: the standard errors of these (c,).
    """

    gain: float
    freedom: int
    step: Array
    error: Array


def gains(
    posterior: Posterior, groups: Mapping[str, Sequence[str] | StreamPattern]
) -> dict[str, Gain]:
    """Return the gain of each group of candidates, from one forward pass at the optimum.

    Args:
        posterior: the optimum.
        groups: names of parameters that are known in the model and might be free, or a pattern of
            the same waves in a freer shape, about the origin of the posterior.
    """
    descent = posterior.state
    shared = {*posterior.model.pattern.names, "growth"}
    count, logs = len(posterior.names), len(posterior.models)
    pairs: list[tuple[str, Sequence[str] | StreamPattern]] = list(groups.items())
    widths = [
        len(group.names) if isinstance(group, StreamPattern)
        else sum(1 if name in shared else logs for name in group)
        for _, group in pairs
    ]  # fmt: skip
    ends = np.cumsum([count, *widths])
    score, information = np.zeros(ends[-1]), np.zeros((ends[-1], ends[-1]))
    for i, model in enumerate(posterior.models):
        chain = np.zeros((len(model.elements), ends[-1]))
        local = model.names
        own = [name if i == 0 or name in shared else f"{name}@{i + 1}" for name in local]
        chain[:, [posterior.names.index(name) for name in own]] = model.jacobian(local)
        for (_, group), first in zip(pairs, ends[:-1].tolist(), strict=True):
            if isinstance(group, StreamPattern):
                slopes = group.jacobian
                chain[-len(slopes) :, first : first + slopes.shape[1]] = slopes
                continue
            spot = first
            for name in group:
                at = spot + (0 if name in shared else i)
                chain[:, at : at + 1] = model.jacobian((name,))
                spot += 1 if name in shared else logs
        columns = np.flatnonzero(np.abs(chain).sum(axis=1))
        forward = Pass.forward(
            StateSpace.of(model, columns), descent.nodes[i], descent.tracks[i],
            descent.spreads[i], keep=False,
        )  # fmt: skip
        chain = chain[columns]
        score += chain.T @ forward.score
        information += chain.T @ forward.information @ chain
    free = slice(0, count)
    inverse, _ = inverted(information[free, free] + posterior.prior, 1e-11)
    result = {}
    for (name, _), first, end in zip(pairs, ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        place = slice(first, end)
        cross = information[place, free] @ inverse
        rest = information[place, place] - cross @ information[free, place]
        away = score[place] - cross @ score[free]
        size = np.sqrt(np.maximum(np.diag(information)[place], 1e-300))
        values, vectors = np.linalg.eigh(rest / size / size[:, None])
        seen = values > 1e-8
        half = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
        covariance = half @ half.T
        step = covariance @ away
        result[name] = Gain(float(away @ step), int(seen.sum()), step, np.sqrt(np.diag(covariance)))
    return result


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
        search = Search(records, known, (), Smoothing())
        end = search.posterior(None).state
        tracks = [(nodes.time, track) for nodes, track in zip(end.nodes, end.tracks, strict=True)]
    else:
        search = Search(records, models, (), Smoothing())
        tracks = [
            (log.time - search.origin[2],
             np.asarray(each, dtype=np.float64)[:, :4] - [*search.origin[:2], 0.0, 0.0])
            for log, each in zip(records, states, strict=True)
        ]  # fmt: skip
    search = Search(records, models, (), Smoothing())
    step = search.step(search.along(tracks))
    covariance, weak = inverted(step.information, search.settings.dependent)
    if len(weak):
        names = ", ".join(search.names[j] for j in weak)
        raise InputError(f"the log does not see all of {names}: there is no bound")
    return covariance
