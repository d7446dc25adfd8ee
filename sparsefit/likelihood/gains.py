"""Score tests: the gain in likelihood of freeing known elements, to second order (Rao 1948)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.causes import ALIKE, FREEDOMS, SHAPES
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.posterior import Posterior

NUDGE = 1e-6  # of a step, to first order
SEEN = 1e-9  # the least eigenvalue of the scaled information of an observable direction


@dataclass(frozen=True, eq=False)
class Gain:
    """The gain of freeing g elements, to second order, all free parameters re-estimated."""

    gain: float  # 2 ln(likelihood ratio), over the posterior's inflation
    step: Array  # of the elements (g,)
    error: Array  # their standard errors (g,)
    moves: tuple[float, float] = (0.0, 0.0)  # relative changes of U0 and L by the step


def groups_of(model: Model, closed: set[str]) -> dict[str, tuple[str, ...]]:
    """The elements that a cause may free, or that a shape of two waves binds, by its name.

    closed: the names of what is free already.
    """
    shut = closed | {name for group in ALIKE if group & closed for name in group}
    groups = {
        name: cause.elements
        for name, cause in FREEDOMS.items()
        if name not in shut and cause.words and not cause.wanders
    }
    groups |= {name: SHAPES[name].elements for name in model.pattern.bound}
    return groups


def gains_of(
    posterior: Posterior, groups: dict[str, tuple[str, ...]]
) -> dict[tuple[str, int], Gain]:
    """Score tests of groups of elements from one forward pass at an optimum.

    Args:
        posterior: the optimum.
        groups: names of elements that are not free.

    Returns:
        Gains by the name of a group and the number, from 1, of the flight that has the elements;
        0 of one flight alone, and of elements that all flights share.
    """
    local, pattern = posterior.model.names, posterior.model.pattern
    members = dict.fromkeys(own for group in groups.values() for own in group)
    step = posterior.under(posterior.models, [own for own in members if own not in local])
    names, size = step.names, np.sqrt(np.maximum(np.diag(step.information), 1e-300))
    scaled, b = step.information / size[:, None] / size, step.score / size
    base = [place for place, name in enumerate(names) if name.partition("@")[0] in local]
    along = np.linalg.lstsq(scaled[np.ix_(base, base)], scaled[base], rcond=1e-12)[0]
    efficient, free = b - along.T @ b[base], scaled - along.T @ scaled[base]
    gains = {}
    for group, elements in groups.items():
        for flight in range(1, len(posterior.legs) + 1):
            suffix = f"@{flight}" if flight > 1 else ""
            if not elements or f"{elements[0]}{suffix}" not in names:
                continue
            added = [names.index(f"{own}{suffix}") for own in elements]
            rest = free[np.ix_(added, added)]
            roots, axes = np.linalg.eigh(0.5 * (rest + rest.T))
            roots, axes = roots[roots > SEEN], axes[:, roots > SEEN]
            along_axes = axes.T @ efficient[added]
            change = axes @ (along_axes / roots) / size[added]
            error = np.sqrt(np.sum(axes**2 / roots, axis=1)) / size[added]
            own_flight = flight if f"{elements[0]}@2" in names else 0
            moved = -(along[:, added] @ (change * size[added])) / size[base]
            ahead = dict(zip((names[place] for place in base), moved.tolist(), strict=True))
            values = zip(pattern.names, pattern.values, strict=True)
            there = tuple(value + NUDGE * ahead.get(name, 0.0) for name, value in values)
            speed, length = pattern.apart(replace(pattern, values=there))
            widening = 1.0 if group in SHAPES else posterior.inflation  # shapes have a BIC
            gains[group, own_flight] = Gain(
                float(np.sum(along_axes**2 / roots)) / widening,
                change,
                error * math.sqrt(widening),
                (speed / NUDGE, length / NUDGE),
            )
    return gains


def chance_of(gain: float, freedom: int) -> float:
    """The probability that chi^2 of so many degrees exceeds a gain (Wilks 1938)."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, max(gain, 0.0)))
