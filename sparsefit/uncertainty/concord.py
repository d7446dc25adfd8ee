"""Whether several flights tell one flow: for each the score of a flow of its own.

With e_f what the fit of all flights leaves of flight f, J_f its Jacobian, S_f the spectrum of its
noise, M = (sum w_g^2 J_g'J_g)^+ and G_f = J_f'J_f, the score of flight f and its covariance are

    s_f = J_f'e_f,    cov s_f = sum_g A_fg (J_g'S_g J_g) A_fg',    A_fg = 1{f = g} - w_g^2 G_f M,

where all noise is of the flights' own: s'(cov s)^+ s is chi^2 of as many degrees as J_f has (Rao,
1948). What noise of the positions adds to the score is known (`bias`), and taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.spectra import frequency_weights
from sparsefit.uncertainty.turbulence import Turbulence

TOLD = 1e-3  # of the largest variance of a score: with less, a flight tells all or nothing there


@dataclass(frozen=True)
class Apart:
    """How far a flight is from the flow that all flights tell.

    Args:
        p_value: how likely flights through one flow come as far apart.
        share: what a flow of its own would change, rms over that of the flow.
        taken: of the squares that are left of the flight, what it would take away.
        by_chance: what it takes of white noise.
    """

    p_value: float
    share: float
    taken: float
    by_chance: float


def concord(
    model: Model, lefts: Sequence[Turbulence], together: Sequence[Array], biases: Sequence[Array]
) -> tuple[Apart, ...]:
    """How far every flight is from the others.

    Args:
        model: of all flights.
        lefts: what a fit of each flight's own leaves, against noise.
        together: what the fit of all leaves of each (m, 2) [m/s].
        biases: E J'e (n,) of the noise in what the columns of each are taken at.
    """
    from scipy.special import gammaincc

    basis = model.information.basis
    fits = [left.observed.fit for left in lefts]
    squares = [fit.weight**2 for fit in fits]
    loads = [basis.T @ _loaded(left) @ basis for left in lefts]
    raw = [
        basis.T @ (fit.plain.jacobian.score(rest) - own)
        for fit, rest, own in zip(fits, together, biases, strict=True)
    ]
    pulled = sum(square * own for square, own in zip(squares, raw, strict=True))  # a refit's step
    whole = sum(square**2 * own for square, own in zip(squares, loads, strict=True))
    found = []
    for place, fit in enumerate(fits):
        told = basis.T @ fit.plain.jacobian.gram @ basis  # M is the identity in this basis
        score = raw[place] - told @ pulled
        cross = squares[place] * told @ loads[place]
        covariance = loads[place] - cross - cross.T + told @ whole @ told
        statistic, rank = _chi_square(score, covariance)
        moved = together[place] - lefts[place].observed.errors
        change, left, flow = (float(np.sum(v**2)) for v in (moved, together[place], fit.plain.flow))
        chance = float(gammaincc(rank / 2, statistic / 2)) if rank else 1.0
        share, taken = (change / flow) ** 0.5 if flow else 0.0, change / (left or 1.0)
        found.append(Apart(chance, share, taken, rank / together[place].size))
    return tuple(found)


def _loaded(left: Turbulence) -> Array:
    """J'S J (n, n) of the samples of one flight."""
    observed = left.observed
    size, jacobian = observed.passage.size, observed.fit.plain.jacobian
    parts = observed.spectra.view(np.float64)
    weight = np.repeat(frequency_weights(size) * left.spectrum, 2)
    return jacobian.onto_theta((parts * weight) @ parts.T)


def _chi_square(score: Array, covariance: Array) -> tuple[float, int]:
    """s'(cov s)^+ s and its degrees, of the directions that are told."""
    roots, vectors = np.linalg.eigh(covariance)
    kept = roots > TOLD * roots[-1]
    turned = vectors[:, kept].T @ score
    return float(np.sum(turned**2 / roots[kept])), int(kept.sum())
