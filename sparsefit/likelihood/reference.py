"""The motion and its elements, and the passes in plain NumPy: filter forward, adjoint backward.

    x' = v
    v' = [(1 + c |r|) r / tau + s R(rho) m + b] / [(1 + mu (t - t_1))(1 - l/tau)]
    r  = (1 + gain)(1 + growth t) w(x - l v, t - l) + wind + wind_growth t - v
    z_x = s_x x(t - latency) + b_x + noise,     z_v = s_v R(rho_v) v + b_v + noise

m is the vehicle's own acceleration in the log [m/s^2], t counts from its middle, the mass from its
start t_1, where it is that of the believed tau and thrust. Every quantity in these lines is an
element; another needs a line in `ELEMENTS`, its place in `force` or `reading`, its derivative in
`passes.pyx`, and a line in `causes`.

The state is a deviation delta from a track s-bar, theta one from its value:

    delta_i+1 = F_i delta_i + g_i + E_i dtheta + kick,    g_i = f(s-bar_i) - s-bar_i+1
    z_i - h(s-bar_i) = H_i delta_i + D_i dtheta + noise

f is one step of Runge and Kutta's fourth order. F, E, H and D are exact: derivatives by a complex
step, Im f(x + i h)/h (Squire and Trapp 1998, SIAM Rev. 40, 110). Half of a step's kick comes before
it, half after, less a third of what the first half makes of the position: what is left where a
step is short is the variance dt^3/3 of a position that white noise accelerates. The filter runs at
dtheta = 0 and carries V = d delta/d dtheta (Friedland 1969, IEEE Trans. Autom. Control 14, 359),
side by side with its covariance as `rows` [P, delta, V]. With an innovation e - G dtheta of the
variance S, `sums` adds (-e, G)'(-e, G)/S up:

    log L(dtheta) = log L(0) + b' dtheta - dtheta' J dtheta/2,   J = sum G'G/S,   b = sum G'e/S

Backwards runs the adjoint r of the state (Bryson and Frazier 1963) with its covariance N:
delta_i given all = delta_i predicted + P_i r_i, and the score of the variance of a kick is
(r^2 - N)/2 (Koopman and Shephard 1992, Biometrika 79, 823). `passes.pyx` is this file compiled,
with derivatives by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray

ELEMENTS: dict[str, float] = {
    "response_time": math.nan,  # tau [s], always given
    "thrust_scale": 1.0,  # s, by which m is multiplied
    "thrust_rotation": 0.0,  # rho [rad], by which it is turned counter-clockwise
    "thrust_bias_x": 0.0,  # b [m/s^2]
    "thrust_bias_y": 0.0,
    "quadratic_drag": 0.0,  # c [s/m]
    "wind_x": 0.0,  # [m/s], carries the vehicle and no pattern
    "wind_y": 0.0,
    "wind_growth_x": 0.0,  # [m/s^2]
    "wind_growth_y": 0.0,
    "mass_rate": 0.0,  # mu [1/s], of the mass by its value at the start of the log
    "lag": 0.0,  # l [s], by which the pull of the air follows the relative wind, to first order
    "gain": 0.0,  # of the flow
    "growth": 0.0,  # [1/s], relative, of the flow
    "position_scale": 1.0,  # s_x
    "velocity_scale": 1.0,  # s_v
    "velocity_bias_x": 0.0,  # b_v [m/s]
    "velocity_bias_y": 0.0,
    "velocity_rotation": 0.0,  # rho_v [rad], of the frame of velocity against that of position
    "latency": 0.0,  # [s], by which a position is older than the velocity of its row
    "position_bias_x": 0.0,  # b_x [m]
    "position_bias_y": 0.0,
}
"""The elements in the order of the passes, with their defaults; those of the waves follow."""
SHAPING = (
    "response_time", "quadratic_drag", "mass_rate", "lag", "position_scale", "velocity_scale",
)  # fmt: skip
"""Elements of F and H, on which the variance of the innovations depends."""
OWN = len(ELEMENTS)
SMALL = 1e-30  # the complex step


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A model as the passes read it; n = 4 + w states: x, y, v_x, v_y, the walkers."""

    elements: Array  # their values (e + 5 j,)
    walkers: IntArray  # the elements (w,) that vary by the states 4 to n
    mixing: Array  # the derivatives (w, w) of these elements by the states
    rates: Array  # their rates beta (w,) [1/s]
    chain: Array  # the derivatives (e + 5 j, p) of the elements by the parameters in question
    kicks: Array  # the variance per second that each level gives to each state (l, n)
    spread: Array  # the variance that each level gives to each state at the start (l, n)
    noise: Array  # the variance that each level gives to each channel (l, 4): position, velocity
    pace: Array  # factors of kicks and of rates in the step from a node (m, n + w)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The result of a backward pass."""

    track: Array  # the states (m, n) given all readings
    adjoint: Array  # r at each node and after it (m + 1, 2 n)
    #: of the readings (m, 12): u, the standardised leave-one-out residual u/sqrt(D), the
    #: standardised innovation e/sqrt(S)
    scores: Array
    #: half the sum of r^2 and of its variance (l, 2), times the variance of each level: their
    #: difference is the derivative of the log-likelihood by its logarithm
    squares: Array
    parts: Array  # the share of each state's kicks in each block of the pass (b, n, 2)


def force(elements: Array, state: Array, time: Array, push: Array, start: float = 0.0) -> Array:
    """v' (2, m) of states (4, m), from elements (e + 5 j, m) and the log's own push (2, m).

    start: t_1, from which the mass counts.
    """
    tau, scale, turn, bx, by, square, wx, wy, gx, gy, rate, lag, gain, growth = elements[:14]
    x, y = state[:2] - lag * state[2:4]
    kx, ky, a, b, omega = elements[OWN:].reshape(-1, 5, len(time)).transpose(1, 0, 2)
    phase = kx * x + ky * y - omega * (time - lag)
    slope = (1.0 + gain) * (1.0 + growth * time) * (b * np.cos(phase) - a * np.sin(phase))
    flow = np.array([(ky * slope).sum(axis=0), -(kx * slope).sum(axis=0)])
    relative = flow + np.array([wx + gx * time, wy + gy * time]) - state[2:4]
    speed = np.sqrt(np.sum(relative**2, axis=0) + 1e-300)
    c, s = np.cos(turn), np.sin(turn)
    turned = scale * np.array([c * push[0] - s * push[1], s * push[0] + c * push[1]])
    drawn = (1.0 + square * speed) * relative / tau
    mass = 1.0 + rate * (time - start)
    pull: Array = (drawn + turned + np.array([bx, by])) / mass / (1.0 - lag / tau)
    return pull


def following(
    space: StateSpace, time: Array, push: Array, elements: Array, states: Array, start: float = 0.0
) -> Array:
    """x, y, v_x, v_y (4, m - 1) a step after states (n, m - 1); time (m,), push (m, 2)."""
    steps = np.diff(time)
    speed = total = np.zeros((4, len(steps)))
    for share, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        fading = np.exp(-share * steps * (space.rates * space.pace[: len(steps), len(states) :]).T)
        full = np.repeat(elements[:, None], len(steps), axis=1).astype(states.dtype)
        np.add.at(full, space.walkers, space.mixing @ (fading * states[4:]))
        here = states[:4] + share * steps * speed
        pushed = (1.0 - share) * push[:-1].T + share * push[1:].T
        pull = force(full, here, time[:-1] + share * steps, pushed, start)
        speed = np.concatenate([here[2:4], pull])
        total = total + weight * speed
    return states[:4] + steps / 6.0 * total


def reading(space: StateSpace, elements: Array, states: Array) -> Array:
    """The readings (4, m) of states (n, m)."""
    full = np.repeat(elements[:, None], states.shape[1], axis=1).astype(states.dtype)
    np.add.at(full, space.walkers, space.mixing @ states[4:])
    place, rate, bias_x, bias_y, turn, latency, offset_x, offset_y = full[14:22]
    late = 1j * latency.imag if np.iscomplexobj(latency) else 0.0  # nodes stand at its real part
    x, y = states[:2] - late * states[2:4]
    c, s = np.cos(turn), np.sin(turn)
    vx, vy = c * states[2] - s * states[3], s * states[2] + c * states[3]
    return np.array(
        [place * x + offset_x, place * y + offset_y, rate * vx + bias_x, rate * vy + bias_y]
    )


def derived(
    function: Callable[[Array, Array], Array], space: StateSpace, states: Array
) -> tuple[Array, Array]:
    """A function (4, m) of elements and states (n, m) as (m, 4), and its slopes (m, 4, n + p)."""
    slopes, still = [], np.zeros(len(states))
    pushes = [(0.0, unit) for unit in np.eye(len(states))] + [(own, still) for own in space.chain.T]
    for of_elements, of_states in pushes:
        elements = space.elements + 1j * SMALL * of_elements
        moved = states + 1j * SMALL * of_states[:, None]
        slopes.append(function(elements, moved).imag.T / SMALL)
    return function(space.elements, states).T, np.stack(slopes, axis=2)


def transitions(
    space: StateSpace, time: Array, push: Array, track: Array, start: float = 0.0
) -> tuple[Array, Array, Array]:
    """The next states (m - 1, n), F (m - 1, n, n) and E (m - 1, n, p) along a track (m, n)."""
    n, steps = track.shape[1], np.diff(time)
    moved, slopes = derived(
        lambda e, s: following(space, time, push, e, s, start), space, track[:-1].T
    )
    fading = np.exp(-steps[:, None] * space.rates * space.pace[: len(steps), n:])
    matrices, inputs = np.zeros((len(steps), n, n)), np.zeros((len(steps), n, space.chain.shape[1]))
    matrices[:, :4], inputs[:, :4] = slopes[:, :, :n], slopes[:, :, n:]
    matrices[:, range(4, n), range(4, n)] = fading
    return np.concatenate([moved, fading * track[:-1, 4:]], axis=1), matrices, inputs


def forward(
    space: StateSpace,
    leg: Any,
    first: int,
    end: int,
    rows: Array,
    sums: Array,
    stored: Array | None,
) -> float:
    """Filter the nodes from `first` to `end`, and go on to the node at `end` if there is one.

    Args:
        leg: the nodes, with s-bar (m, n) as its track (`trellis.Leg`).
        rows: P, delta and V (n, n + 1 + q) at the first node, changed in place; the columns are
            those of the parameters (p,), then of the logarithms of the levels, if any: these need
            the leg's last backward pass.
        sums: (1 + q, 1 + q), added to.
        stored: written for the backward pass (end - first, `width`); None: not wanted.

    Returns:
        The sum of log(2 pi S), infinite where rounding has won.
    """
    n, p = leg.track.shape[1], space.chain.shape[1]
    c, half = n + 1 + p, np.diag_indices(n)
    last = leg.last if rows.shape[1] > c else None
    part = slice(first, min(end + 1, len(leg.time)))
    time, along, space = leg.time[part], leg.track[part], replace(space, pace=space.pace[part])
    ahead, matrices, inputs = transitions(space, time, leg.push[part], along, leg.time[0])
    seen, slopes = derived(lambda e, s: reading(space, e, s), space, along.T)
    kick, spread, total = space.kicks.sum(axis=0), space.noise.sum(axis=0), 0.0
    for i, node in enumerate(range(first, end)):
        if stored is not None:
            stored[i, : n * c] = rows[:, :c].ravel()
            gains = stored[i, n * c : -4 * n].reshape(4, n + c + 1)
        for channel in np.flatnonzero(leg.weights[node]):
            h, weight = slopes[i, channel, :n], leg.weights[node, channel]
            response = h @ rows  # H P, -e and G
            response[n] += seen[i, channel] - leg.measured[node, channel]
            response[n + 1 : c] += slopes[i, channel, n:]
            if last is not None:
                response[c:] += space.noise[:, channel] * last.scores[node, channel] / weight
            size = response[:n] @ h + spread[channel] / weight
            if not size > 0.0:  # the covariance has lost its sign
                return math.inf
            rows -= np.outer(response[:n] / size, response)
            sums += np.outer(response[n:] / size, response[n:])
            total += math.log(2.0 * math.pi * size)
            if stored is not None:
                gains[channel] = np.concatenate([h, response[:c], [size]])
        if node + 1 == len(leg.time):
            break
        step, matrix = time[i + 1] - time[i], matrices[i]
        excess = step / 6.0 * matrix[range(2), range(2, 4)] ** 2
        own = 0.5 * step * space.pace[i, :n]
        if last is not None:
            rows[:, c:] += (own * space.kicks * last.adjoint[node, n:]).T
        rows[half] += own * kick
        rows[:] = matrix @ rows
        rows[:, :n] = rows[:, :n] @ matrix.T
        rows[half] += own * kick
        rows[range(2), range(2)] -= excess * kick[2:4]
        rows[:, n] += ahead[i] - along[i + 1]
        rows[:, n + 1 : c] += inputs[i]
        if last is not None:
            rows[:, c:] += (own * space.kicks * last.adjoint[node + 1, :n]).T
            rows[:2, c:] -= (excess * space.kicks[:, 2:4] * last.adjoint[node + 1, :2]).T
        if stored is not None:
            stored[i, -4 * n :] = matrix[:4].ravel()
    return total


def width(n: int, p: int) -> int:
    """The numbers that a node of n states and p parameters stores for the backward pass."""
    return n * (n + 1 + p) + 4 * (2 * n + p + 2) + 4 * n


def backward(
    space: StateSpace,
    leg: Any,
    first: int,
    end: int,
    change: Array,
    stored: Array,
    carried: Array,
    result: Smoothed,
    sums: Array,
) -> None:
    """Run the adjoint through a block, from its last node to its first.

    Args:
        change: 1, then dtheta of the parameters (1 + p,).
        stored: written by `forward`.
        carried: r and N of the node after the block (1 + n, n): changed in place.
        result: its delta is added to the track; its adjoint and scores are written.
        sums: (n, 2) sums of r^2 and of N over the half kicks, times their seconds, those of the
            velocity less their excess; then (4, 2) of R u^2 and of R times its variance over the
            readings: added to.
    """
    n, c = carried.shape[1], carried.shape[1] + len(change)
    r, covariance, noise = carried[0], carried[1:], space.noise.sum(axis=0)
    for node in range(end - 1, first - 1, -1):
        saved = stored[node - first]
        if node + 1 < len(leg.time):
            step = leg.time[node + 1] - leg.time[node]
            matrix = np.zeros((n, n))
            matrix[:4] = saved[-4 * n :].reshape(4, n)
            pace, paces = space.pace[node, :n], space.pace[node, n:]
            matrix[range(4, n), range(4, n)] = np.exp(-space.rates * paces * step)
            squares = np.column_stack([r**2, np.diag(covariance)])
            sums[:n] += 0.5 * step * pace[:, None] * squares
            sums[2:4] -= step / 6.0 * matrix[range(2), range(2, 4)][:, None] ** 2 * squares[:2]
            r[:] = matrix.T @ r
            covariance[:] = matrix.T @ covariance @ matrix
            sums[:n] += 0.5 * step * pace[:, None] * np.column_stack([r**2, np.diag(covariance)])
        result.adjoint[node, n:] = r
        gains = saved[n * c : -4 * n].reshape(4, n + c + 1)
        result.scores[node] = 0.0
        for channel in np.flatnonzero(leg.weights[node])[::-1]:
            h, response, size = gains[channel, :n], gains[channel, n:-1], gains[channel, -1]
            gain, innovation = response[:n] / size, -response[n:] @ change
            along = covariance @ gain
            u, spread = innovation / size - gain @ r, 1.0 / size + gain @ along
            row = u, u / math.sqrt(spread), innovation / math.sqrt(size)
            result.scores[node, channel::4] = row
            r += h * u
            covariance += spread * np.outer(h, h) - np.outer(h, along) - np.outer(along, h)
            variance = noise[channel] / leg.weights[node, channel]
            sums[n + channel] += variance * u * u, variance * spread
        result.adjoint[node, :n] = r
        filtered = saved[: n * c].reshape(n, c)
        result.track[node] += filtered[:, :n] @ r + filtered[:, n:] @ change
