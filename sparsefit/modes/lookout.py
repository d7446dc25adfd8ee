"""Where waves may be: the rows that they are fitted to, and the scans that show where to start."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.library.drift_scan import DriftScan
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.pieced_waves import PiecedWaves
from sparsefit.library.plane_scan import PlaneScan, crossed, peaks
from sparsefit.library.waves import SQUARE, Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.plane import descended, residuals
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.space import FALSE_ALARM, SearchSpace, concentration

SQUARES, DESCENDED = 20, 4  # peaks of the scan that are ranked by their fit, and descended into
STRONG = 24  # peaks of single waves, of which rectangles are made
ALIKE = 0.15  # of |k|: waves that differ by less may be those of a rectangle
MOVING = 8  # peaks of squares that drift
OMEGAS = 100.0  # that are told apart, about
FASTEST = 0.6  # of sqrt(2 <Phi^2>): drifts beyond it are not looked for
EXACT = 1e-6  # of |Phi|^2: squares below it are what smoothing takes, and tell no shape
CLOSE = 0.5  # in pi/extent: waves nearer than that are one, with amplitudes of opposite sign
STRONGEST = 6.0  # of the rms of a component of Phi: a wave that strong is one of two that cancel
PART = 0.05  # of |Phi|^2: errors that are more could hide a flow
LOUD, SPREAD = 2.0, 6.0  # of the mean power, and of its standard deviation: more is a flow


@dataclass(frozen=True, eq=False)
class Lookout:
    """What the ladder is fitted to.

    Args:
        space: that cells were searched in.
        rows: all rows, with the time as third coordinate.
        thin: fewer of the samples, to search with.
        worth: how many rows, of both components, count where errors correlate.
    """

    space: SearchSpace
    rows: Rows
    thin: Rows
    worth: float

    @classmethod
    def of(cls, space: SearchSpace, time: Array) -> Lookout:
        """Of a flight's samples at time (m,) [s]."""
        thin = space.sampled.timed(time).thinned(max(1, int(0.5 * space.correlation)))
        rows = space.rows.timed(time)
        return cls(space, rows, thin, 2 * len(rows.target) / space.correlation)

    @cached_property
    def target(self) -> Array:
        """What nuisance columns leave of Phi (m, 2) [m/s]."""
        return project(Waves(), self.thin, np.zeros((0, 2))).rest

    @cached_property
    def _power(self) -> Array:
        return _power(self.target)

    @cached_property
    def scan(self) -> PlaneScan:
        """The plane of wavevectors of square cells between the bounds of the length scale."""
        return PlaneScan.of(self.thin.position, self._radii, self.thin.scale)

    @property
    def _radii(self) -> tuple[float, float]:
        low, high = self.space.bounds
        return math.sqrt(2) * low, math.sqrt(2) * high

    @cached_property
    def _gains(self) -> Array:
        return self.scan.gains(self.target)

    def coloured(self, rest: Array) -> Lookout:
        """The same where errors (m, 2) of thinned rows correlate as far as these do."""
        return replace(self, worth=min(self.worth, 2 * len(rest) / concentration(rest)))

    def bic(self, family: Waves | EqualWaves, fit: Projection) -> float:
        """N ln RSS + p ln n of a fit, n the rows that count, RSS over |Phi|^2."""
        parameters = (family.parameters + family.size) * len(fit.parameters)
        share = max(fit.residual / self._square(fit), EXACT)
        return self.worth * math.log(share) + parameters * math.log(self.worth)

    def reaching(self, bic: float, parameters: int) -> float:
        """The RSS of thin rows at which so many parameters have a BIC."""
        share = math.exp((bic - parameters * math.log(self.worth)) / self.worth)
        return share * float(np.sum(self.thin.target**2))

    def _square(self, fit: Projection) -> float:
        """|Phi|^2 of the rows that were fitted, [m^2/s^2]."""
        target = (self.thin if len(fit.rest) == len(self.thin.target) else self.rows).target
        return float(np.sum(target**2)) or 1.0

    def quiet(self, rest: Array) -> bool:
        """Whether errors (m, 2) have no more power where Phi has its own than elsewhere.

        Where they are a good part of Phi, no wave may explain more of them than chance does either.
        """
        size = float(np.sum(rest**2)) / (float(np.sum(self.target**2)) or 1.0)
        if size <= EXACT:
            return True
        own, left = self._power, _power(rest)
        if not own.any():
            return True
        share = own / own.sum()
        spread = math.sqrt(0.5 * float(np.sum(share**2)))
        if float(share @ left) > (LOUD + SPREAD * spread) * float(left.mean()):
            return False
        return size < PART or self._unexplained(rest)

    def _unexplained(self, rest: Array) -> bool:
        """Whether no wave explains more of errors (m, 2) than chance does."""
        whole, gain = float(np.sum(rest**2)), float(self.scan.gains(rest).max())
        most = 2 * math.log(self.places / FALSE_ALARM) + 2 * Waves().size
        return -self.worth * math.log(max(1 - gain / whole, EXACT)) < most

    def blown(self, waves: Projection) -> bool:
        """Whether single waves are so strong that two of them nearly cancel."""
        sizes = np.hypot(*waves.parameters[:, :2].T) * np.linalg.norm(waves.weights[..., 0], axis=1)
        return bool(sizes.max() > STRONGEST * math.sqrt(float(np.mean(self.target**2))))

    def close(self, waves: Projection) -> bool:
        """Whether two of single waves that stand are so close that they are one."""
        k = waves.parameters[:, :2]
        first, second = np.triu_indices(len(k), 1)
        apart = [k[first] + sign * k[second] for sign in (-1.0, 1.0)]
        nearest = float(np.linalg.norm(apart, axis=2).min(initial=math.inf))
        return nearest < CLOSE * self.scan.step

    @property
    def places(self) -> float:
        """How many waves the scan can tell apart."""
        return max(1.0, 0.5 * float(self.scan.inside.sum()))

    def ranked(self, family: Waves | PiecedWaves, starts: Array) -> Array:
        """The starts (j, p) of most promise, by what they leave as they are, the best first."""
        if not len(starts):
            return starts
        order = np.argsort(residuals(family, self.thin, starts), kind="stable")
        ranked: Array = starts[order[:DESCENDED]]
        return ranked

    def chance(self, family: Waves | EqualWaves, fit: Projection) -> float:
        """What 2 ln(likelihood ratio) of waves to a wind reaches by chance in 1 of 1000 flights."""
        waves = family.pattern.size * len(fit.parameters)
        places = self.places * (OMEGAS if family.pattern.drifting else 1.0)
        free = (family.parameters + family.size) * len(fit.parameters)
        return 2 * waves * math.log(places) - 2 * math.log(FALSE_ALARM) + free

    def squares(self) -> Array:
        """Squares (j, 2), (k, heading), that explain much."""
        k = self.scan.axis[peaks(crossed(self._gains), SQUARES, square=True)]
        return np.column_stack([np.hypot(*k.T) / math.sqrt(2), _heading(k)])

    def rectangles(self) -> Array:
        """Rectangles (j, 3), (k_x, k_y, heading), of two strong waves that are equally long."""
        strong = self.scan.axis[peaks(self._gains, STRONG)]
        found = []
        for one, other in combinations(strong, 2):
            lengths = np.hypot(*np.stack([one, other]).T)
            if abs(lengths[0] - lengths[1]) <= ALIKE * lengths.max():
                total, difference = 0.5 * (one + other), 0.5 * (one - other)
                sides = np.hypot(*total), np.hypot(*difference)
                found.append((*sides, math.atan2(total[1], total[0])))
        return np.array(found).reshape(-1, 3)

    def pairs(self) -> Array:
        """Pairs (j, 4) of the strongest wave and the strongest in what it leaves."""
        start = self.strong(self.target, 1)
        if not len(start):  # nothing to explain: a logged velocity of zeros, say
            return np.empty((0, 4))
        first = descended(Waves(), self.thin, start, rough=True)
        second = self.scan.axis[peaks(self.scan.gains(first.rest), 2)]
        return np.column_stack([np.repeat(first.parameters, len(second), axis=0), second])

    def strong(self, rest: Array, most: int) -> Array:
        """The waves (j, 2) that explain most of errors (m, 2), one beside another."""
        waves: Array = self.scan.axis[peaks(self.scan.gains(rest), most)]
        return waves

    def drifting_squares(self) -> tuple[int, Array]:
        """Squares that drift (j, 4), the most promising first, and of how many pieces."""
        fastest = FASTEST * math.sqrt(2 * float(np.mean(np.sum(self.target**2, axis=1))))
        scan = DriftScan.of(self.thin.position, self._radii, fastest)
        gains, (axis, omega) = scan.gains(self.target)
        highest, at = gains.max(axis=2), omega[gains.argmax(axis=2)]
        i, j = peaks(crossed(highest), MOVING, square=True).T
        k = np.column_stack([axis[i], axis[j]])
        # The second wave of a square is the first one turned clockwise, (k_y, -k_x).
        omegas = [at[i, j], at[j, len(axis) - 1 - i]]
        starts = np.column_stack([np.hypot(*k.T) / math.sqrt(2), *omegas, _heading(k)])
        return scan.pieces, self.ranked(PiecedWaves(SQUARE.moving, scan.pieces), starts)

    def followed(self, pieces: int, start: Array, goal: float) -> Projection:
        """A square that drifts, (4,), followed from pieces to the whole flight, while RSS < goal.

        Joined pieces leave more than free ones.
        """
        parameters = start[None]
        while True:
            family = PiecedWaves(SQUARE.moving, pieces)
            fit = descended(family, self.thin, parameters, rough=True, goal=goal)
            if pieces == 1 or fit.residual > goal:
                return fit
            parameters, pieces = fit.parameters, (pieces + 1) // 2


def _power(values: Array) -> Array:
    """The power (f,) of both components of values (m, 2), by frequency."""
    spectra = np.fft.rfft(values, axis=0)
    power: Array = np.sum(spectra.real**2 + spectra.imag**2, axis=1)
    return power


def _heading(waves: Array) -> Array:
    """The heading (j,) of squares whose first wave is at k (j, 2)."""
    heading: Array = np.arctan2(waves[:, 1], waves[:, 0]) - math.pi / 4
    return heading
