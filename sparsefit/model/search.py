"""The search: which shapes of flow flights bear out, as starts for the likelihood that measures.

Rows are thinned samples of the flow velocity; the ladder of shapes (`sparsefit.model.ladder`) is
climbed on them. Precision, and the choice among what is close, are the likelihood's. A track that
is too long for the least length scale is refused at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.model.fitting import FlowRows, ShapeFit, fitted
from sparsefit.model.grid import extent_of, middle
from sparsefit.model.ladder import Ladder, Lookout
from sparsefit.model.library import Library
from sparsefit.model.scan import line_steps
from sparsefit.model.shapes import AXIS
from sparsefit.model.unknowns import JointUnknowns
from sparsefit.rows import Samples

CORRELATION = 5.0  # samples: errors of smoothed derivatives and of positions are not white
ROUNDS, LEAST_LEVEL = 2, 1e-3  # of weighing flights; of the largest level of noise


@dataclass(frozen=True)
class Start:
    """The proposals of a back-end's weights, hashable: equal ones lead to equal answers.

    Args:
        refine: ``variable-projection`` or ``ladder``.
        lobe: the wavenumber [1/m] of the scan's lobe nearest to a candidate scale; 0: none.
        windows: wavenumbers (k, low, high) [1/m] of several length scales, strongest first.
        waves: wavevectors (k_x, k_y) [rad/m] of a wave library, strongest first.
    """

    refine: str = "ladder"
    lobe: float = 0.0
    windows: tuple[tuple[float, float, float], ...] = ()
    waves: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Proposal:
    """A flow that the rows bear out: psi = sum a cos(phi) + b sin(phi), phi = k.(x - c t).

    Args:
        shape: ``axis``, ``square``, ``rectangle``, ``pair`` or ``several``.
        wavevectors: k (j, 2) [rad/m].
        cosine: a (j,) [m^2/s], in the flight's own coordinates and time.
        sine: b (j,) [m^2/s].
        drift: c [m/s], (0, 0) where it stands.
        drifting: whether the shape may drift.
        residual: RSS of the rows over |Phi|^2.
        bic: n ln RSS + p ln n.
        vehicles: of each flight with its unknowns as the rows have them; as believed where the
            rows say what cannot be.
        background: the steady uniform velocity beside the flow [m/s], of the first flight.
    """

    shape: str
    wavevectors: Array
    cosine: Array
    sine: Array
    drift: tuple[float, float]
    drifting: bool
    residual: float
    bic: float
    vehicles: tuple[PointMassVehicle, ...]
    background: tuple[float, float] = (0.0, 0.0)

    @property
    def flow(self) -> WaveFlow:
        """The flow that is proposed."""
        return WaveFlow(self.wavevectors, self.cosine, self.sine, self.wavevectors @ self.drift)

    def lobe(self, extent: float) -> tuple[str, bool, bytes]:
        """A key that proposals share whose phases differ by some 1e-6 over an extent [m]."""
        phases = np.append(self.wavevectors * extent, self.drift)
        return self.shape, self.drifting, (np.round(phases, 6) + 0.0).tobytes()

    @property
    def mean_velocity(self) -> float:
        """U0 [m/s]."""
        return self.flow.mean_velocity

    @property
    def length_scale(self) -> float:
        """L [m] of its two strongest waves."""
        squares = np.sum(self.wavevectors**2, axis=1)
        order = np.argsort(-squares * (self.cosine**2 + self.sine**2), kind="stable")[:2]
        return math.pi * math.sqrt(2.0 / float(np.mean(squares[order])))


@dataclass(frozen=True, eq=False)
class Search:
    """The search for a library's flow in one flight, or in several through one flow.

    Args:
        lookout: thinned rows and their scans.
        origin: (x, y, t) from which the rows count.
        unknowns: the columns of each flight's unknowns.
        counts: the rows of each flight.
    """

    lookout: Lookout
    origin: Array
    unknowns: JointUnknowns
    counts: tuple[int, ...]

    @classmethod
    def of(
        cls,
        flights: Sequence[Samples],
        vehicles: Sequence[PointMassVehicle],
        library: Library,
        weights: Sequence[float] = (),
    ) -> Search:
        """The search for a library's flow in flights; weights: of the rows of each.

        Raises InputError where the flights do not move, or are too long for the least length scale.
        """
        weights = tuple(weights) or (1.0,) * len(flights)
        position = np.concatenate([samples.position for samples in flights])
        extent, least = extent_of(position), library.grid.lower
        if not extent > 0:
            raise InputError("the flight does not move: no length scale can be told; fly farther")
        if line_steps(extent, library.bounds) > 150_000:  # more lobes are looked into by nobody
            raise InputError(
                f"a length scale of {least:.3g} m is too small for a flight of {extent:.3g} m: "
                "too many lobes; raise the grid's lower bound"
            )
        unknowns = JointUnknowns.of(library.unknown, vehicles)
        time = np.concatenate([samples.time for samples in flights])
        origin = np.array([*middle(position), 0.5 * (time.min() + time.max())])
        thin, worth = [], 0.0
        for samples in flights:
            correlation = CORRELATION
            if samples.smoothing is not None:
                correlation = max(CORRELATION, samples.smoothing.correlation)
            worth += 2 * len(samples.time) / correlation
            way = np.hypot(*np.diff(samples.position, axis=0).T)
            far = max(1, int(0.25 * least / max(float(np.median(way)), 1e-300)))
            # 1,500 rows where they are a quarter of the least length scale apart, 6,000 of any.
            most = 1_500 // len(flights) + 1
            stride = max(int(0.5 * correlation), min(far, len(way) // most))
            thin.append(samples.every(max(1, stride, len(way) // 6_000)))
        counts = tuple(len(samples.time) for samples in thin)
        own = np.repeat(np.array(weights, dtype=float), counts)
        place = [np.column_stack([samples.position, samples.time]) for samples in thin]
        phi = [
            samples.flow_velocity(vehicle) for samples, vehicle in zip(thin, vehicles, strict=True)
        ]
        rows = FlowRows(
            np.concatenate(place) - origin,
            own[:, None] * np.concatenate(phi),
            own[:, None, None] * np.concatenate(unknowns.columns(thin)),
            own if len(flights) > 1 else None,
        )
        worth = min(worth, 2.0 * len(own))
        return cls(Lookout(rows, library.bounds, worth), origin, unknowns, counts)

    def propose(self, start: Start) -> tuple[Proposal, ...]:
        """The flows that the rows bear out, best first, rivals included; none where none is."""
        ladder = Ladder(self.lookout)
        if start.windows:
            ladder.length_scales(start.windows)
        else:
            if not len(self.lookout.lobes):
                return ()
            ladder.lines(start.lobe)
            if start.refine == "ladder":
                ladder.climb(np.array(start.waves).reshape(-1, 2))
            elif start.waves:
                ladder.tried.clear()
                ladder.join(np.array(start.waves))
        return tuple(self._proposal(*ranked) for ranked in ladder.ranked())

    def _proposal(self, fit: ShapeFit, bic: float) -> Proposal:
        """A fit in the flight's own coordinates, amplitudes of the vehicle that fits best."""
        shift = fit.phases * (1.0, 1.0, -1.0) @ self.origin
        a, b = fit.weights.reshape(-1, 2).T
        cosine = a * np.cos(shift) - b * np.sin(shift)
        sine = a * np.sin(shift) + b * np.cos(shift)
        read = self.unknowns.read(fit.coefficients)
        pairs = zip(read, self.unknowns.ratios(fit.coefficients), strict=True)
        possible = [(steady, own) for (vehicle, steady), own in pairs if vehicle is not None]
        ratio = float(np.mean([own for _, own in possible])) if possible else 1.0
        vehicles = [part.believed for part in self.unknowns.parts]
        if read:
            vehicles = [own or other for (own, _), other in zip(read, vehicles, strict=True)]
        drift = (float(fit.q[-2]), float(fit.q[-1])) if fit.shape.drifting else (0.0, 0.0)
        return Proposal(
            fit.shape.name,
            fit.phases[:, :2],
            cosine / ratio,
            sine / ratio,
            drift,
            fit.shape.drifting,
            fit.residual / self.lookout.rows.square,
            bic,
            tuple(vehicles),
            possible[0][0] if possible else (0.0, 0.0),
        )


def flight_weights(
    flights: Sequence[Samples], vehicles: Sequence[PointMassVehicle], library: Library
) -> tuple[float, ...]:
    """The weight of each flight's rows: one over the level of what the best cells leave of it.

    Of mean square 1 over all rows; one flight has weight 1.
    """
    counts, weights = [len(samples.time) for samples in flights], np.ones(len(flights))
    for _ in range(ROUNDS if len(flights) > 1 else 0):
        search = Search.of(flights, vehicles, library, weights.tolist())
        rows = search.lookout.rows
        best = fitted(rows, AXIS, search.lookout.lobes[:1])
        assert rows.weight is not None
        rest = np.sum((best.rest / rows.weight[:, None]) ** 2, axis=1)
        flight = np.repeat(np.arange(len(flights)), search.counts)
        levels = np.sqrt(np.bincount(flight, rest) / np.bincount(flight))
        levels = np.maximum(levels, LEAST_LEVEL * levels.max())
        if not levels.min() > 0:
            break
        weights = 1 / (levels * np.sqrt(np.average(levels**-2, weights=counts)))
    return tuple(weights.tolist())
