"""What is mended in a log before a derivative is taken: by stated rules, counted, or not at all.

In this order: rows that only repeat the one before are dropped; gaps cut the flight into pieces;
uneven time steps are made even, for the derivatives that need it (`sparsefit.derivative.pieces`);
jumps of the position are taken out, and outliers of the velocity replaced, where steps are even
and both are measured (`sparsefit.derivative.outliers`). A clean flight comes out as the very arrays
that went in.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from sparsefit.derivative.outliers import clean_position, clean_velocity
from sparsefit.derivative.pieces import Pieces, cut
from sparsefit.flight import Flight
from sparsefit.flight.record import MINIMUM_SAMPLES

HELD = 2.0  # least increments of the log: who moves farther cannot be where he was


@dataclass(frozen=True)
class Repairs:
    """What was mended in a flight.

    Args:
        outliers: velocities that were replaced.
        jumps: steps of the position that were taken out.
        gaps: interruptions that no derivative was taken across.
        resampled: samples on even time steps that stand for those on uneven ones.
        repeated: samples that were dropped as they repeat the position of the one before.
        dropped: samples between gaps that were too few to be smoothed.
        largest_outlier: [m/s], 0 where there is none.
        largest_jump: [m].
        longest_gap: [s].
    """

    outliers: int = 0
    jumps: int = 0
    gaps: int = 0
    resampled: int = 0
    repeated: int = 0
    dropped: int = 0
    largest_outlier: float = 0.0
    largest_jump: float = 0.0
    longest_gap: float = 0.0

    @property
    def none(self) -> bool:
        """Whether the flight was left as it was."""
        return not any(getattr(self, field.name) for field in fields(self))

    @property
    def words(self) -> str:
        """What was mended, in words; empty where nothing was."""
        parts = [
            _told(self.outliers, "outlier", f" of up to {self.largest_outlier:.3g} m/s replaced"),
            _told(self.jumps, "jump", f" of up to {self.largest_jump:.3g} m taken out"),
            _told(self.gaps, "gap", f" of up to {self.longest_gap:.3g} s left open"),
            _told(self.resampled, "sample", " put on even time steps"),
            _told(self.repeated, "repeated sample", " dropped"),
            _told(self.dropped, "sample", " between gaps dropped"),
        ]
        return ", ".join(part for part in parts if part)


def _told(count: int, noun: str, what: str) -> str:
    return f"{count} {noun}{'s' if count > 1 else ''}{what}" if count else ""


def repaired(flight: Flight, *, even: bool, shortest: int) -> tuple[Pieces, Repairs]:
    """The samples of a flight, mended, and what was.

    Args:
        flight: the flight.
        even: whether uneven time steps are made even.
        shortest: samples of a piece that the derivative can be taken of; shorter ones are dropped
            where there are longer ones.
    """
    fresh = _fresh(untouched(flight))
    whole = cut(fresh)
    pieces = whole.longer_than(shortest)
    gaps = np.diff(pieces.time)[pieces.starts - 1]
    repairs = Repairs(
        gaps=len(gaps),
        longest_gap=float(gaps.max(initial=0.0)),
        repeated=flight.samples - len(fresh.time),
        dropped=len(whole.time) - len(pieces.time),
    )
    if not pieces.even():
        if not even:
            return pieces, repairs
        pieces = pieces.resampled()
        repairs = replace(repairs, resampled=len(pieces.time))
    return _cleaned(pieces, repairs) if flight.velocity_measured else (pieces, repairs)


def untouched(flight: Flight) -> Pieces:
    """The samples of a flight as they are."""
    none = np.empty(0, dtype=np.intp)
    arrays = flight.time, flight.position, flight.velocity
    return Pieces(*arrays, none, flight.velocity_measured)


def _fresh(log: Pieces) -> Pieces:
    """Without the rows whose position is that of the row before, if the log holds its samples.

    It does where the vehicle moved on at most of these rows; one that rests repeats itself.
    """
    moved = np.abs(np.diff(log.position, axis=0))
    held = ~moved.any(axis=1)
    if held.any() and moved.any():
        far = np.abs(log.velocity[1:]).max(axis=1) * np.diff(log.time)
        left = held & (far > HELD * float(moved[moved > 0].min()))
        rows = np.concatenate([[True], ~held])
        if 2 * left.sum() > held.sum() and rows.sum() >= MINIMUM_SAMPLES:
            fresh = log.time[rows], log.position[rows], log.velocity[rows]
            return Pieces(*fresh, log.starts, log.velocity_measured)
    return log


def _cleaned(pieces: Pieces, repairs: Repairs) -> tuple[Pieces, Repairs]:
    """Without jumps and outliers, piece by piece."""
    step, positions, velocities, jumps, outliers = pieces.step(), [], [], [], []
    for piece in pieces.slices:
        position, far = clean_position(pieces.position[piece], pieces.velocity[piece], step)
        velocity, found = clean_velocity(position, pieces.velocity[piece], step)
        off = velocity[found] - pieces.velocity[piece][found]
        positions.append(position)
        velocities.append(velocity)
        jumps.append(far)
        outliers.append(np.hypot(*off.T))
    sizes, speeds = np.concatenate(jumps), np.concatenate(outliers)
    if not len(sizes) and not len(speeds):
        return pieces, repairs
    cleaned = replace(
        pieces, position=np.concatenate(positions), velocity=np.concatenate(velocities)
    )
    return cleaned, replace(
        repairs,
        outliers=len(speeds),
        jumps=len(sizes),
        largest_outlier=float(speeds.max(initial=0.0)),
        largest_jump=float(sizes.max(initial=0.0)),
    )
