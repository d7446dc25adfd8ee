"""The passes in plain NumPy: a step of the motion with its derivatives, the filter, the adjoint.

The state is written as a deviation delta from a track s-bar, theta as one from its value:

    delta_i+1 = F_i delta_i + g_i + E_i dtheta + kick,    g_i = f(s-bar_i) - s-bar_i+1
    z_i - h(s-bar_i) = H_i delta_i + D_i dtheta + noise

f is one step of Runge and Kutta's fourth order, F and E its exact derivatives. Half of a step's
kick comes before it, half after. The filter runs at dtheta = 0 and carries V = d delta/d dtheta
(Friedland 1969, IEEE Trans. Autom. Control 14, 359); an innovation is then e - G dtheta, and

    log L(dtheta) = log L(0) + b' dtheta - dtheta' J dtheta/2,   J = sum G'G/S,   b = sum G'e/S

Backwards runs the adjoint r of the state (Bryson and Frazier 1963) with its covariance N:
delta_i given all = delta_i predicted + P_i r_i, and the score of the variance of a kick is
(r^2 - N)/2 (Koopman and Shephard 1992, Biometrika 79, 823). `passes.pyx` is this file compiled.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array, IntArray

OWN = 22  # elements before those of the waves, in the order of `model.ELEMENTS`
TINY = 1e-300


def acceleration(
    elements: Array, ids: IntArray, state: Array, time: Array, thrust: Array
) -> tuple[Array, Array, Array]:
    """Return v' and its derivatives by the state and by elements.

    Args:
        elements: their values (m, 22 + 5 j).
        ids: the elements (c,) to derive by.
        state: x, y, v_x, v_y (m, 4).
        time: from the middle of the log (m,) [s].
        thrust: m (m, 2) [m/s^2].

    Returns:
        v' (m, 2), its derivatives by x, y, v_x, v_y (m, 2, 4) and by the elements (m, 2, c).
    """
    tau, scale, turn, bx, by, drag, wx, wy, gx, gy, rate, lag, gain, growth = elements[:, :14].T
    speeds = state[:, 2:4].T
    (x, y), t = state[:, :2].T - lag * speeds, time - lag
    swell, shape = 1.0 + gain, 1.0 + growth * time
    kx, ky, a, b, omega = elements[:, OWN:].reshape(len(x), -1, 5).transpose(2, 1, 0)
    phase = kx * x + ky * y - omega * t
    cos, sin = swell * shape * np.cos(phase), swell * shape * np.sin(phase)
    slope, psi = b * cos - a * sin, a * cos + b * sin
    px, py = -ky * psi, kx * psi
    air, own = np.zeros((2, 2, elements.shape[1], len(x)))  # of the wind, of the acceleration
    air[:, OWN + 0 :: 5] = px * x, py * x - slope
    air[:, OWN + 1 :: 5] = px * y + slope, py * y
    air[:, OWN + 2 :: 5] = -ky * sin, kx * sin
    air[:, OWN + 3 :: 5] = ky * cos, -kx * cos
    air[:, OWN + 4 :: 5] = -px * t, -py * t
    flow = np.array([(ky * slope).sum(axis=0), -(kx * slope).sum(axis=0)])
    gradient = np.array([[(kx * p).sum(axis=0), (ky * p).sum(axis=0)] for p in (px, py)])
    relative = flow + np.array([wx + gx * time, wy + gy * time]) - speeds
    speed = np.sqrt(np.sum(relative**2, axis=0) + TINY)
    c, d, (push, side) = np.cos(turn), np.sin(turn), thrust.T
    turned = np.array([c * push - d * side, d * push + c * side])
    mass = 1.0 + rate * time
    weight = 1.0 / (mass * (1.0 - lag / tau))
    drawn = (1.0 + drag * speed) * relative / tau
    result = weight * (drawn + scale * turned + np.array([bx, by]))
    by_air = drag / speed * relative[:, None] * relative
    by_air = weight / tau * (by_air + (1.0 + drag * speed) * np.eye(2)[:, :, None])
    by_place = np.einsum("ijm,jkm->ikm", by_air, gradient)
    by_state = np.concatenate([by_place, -by_air - lag * by_place], axis=1)
    air[0, 6], air[1, 7], air[0, 8], air[1, 9] = 1.0, 1.0, time, time
    change = -np.array([(omega * px).sum(axis=0), (omega * py).sum(axis=0)])
    air[:, 11] = -np.einsum("ijm,jm->im", gradient, speeds) - change
    air[:, 12], air[:, 13] = flow / swell, flow * time / shape
    own[:, 0] = -weight * drawn / tau - lag / (tau * (tau - lag)) * result
    own[:, 1], own[:, 2] = weight * turned, weight * scale * np.array([-turned[1], turned[0]])
    own[0, 3], own[1, 4], own[:, 5] = weight, weight, weight * speed / tau * relative
    own[:, 10], own[:, 11] = -result * time / mass, result / (tau - lag)
    by_elements = own[:, ids] + np.einsum("ijm,jem->iem", by_air, air[:, ids])
    return result.T, by_state.transpose(2, 0, 1), by_elements.transpose(2, 0, 1)


def transitions(
    elements: Array,
    walkers: IntArray,
    rates: Array,
    columns: IntArray,
    time: Array,
    thrust: Array,
    track: Array,
) -> tuple[Array, Array]:
    """Return the step from every node to the next, and its derivatives.

    Args:
        elements: their values (22 + 5 j,).
        walkers: the elements (w,) of the states from the fourth on.
        rates: their rates (w,).
        columns: the elements (p,) of the other derivatives.
        time: of the nodes (m,) [s].
        thrust: at the nodes (m, 2), a straight line between them.
        track: the states s-bar (m, 4 + w).

    Returns:
        The next states (m - 1, 4 + w) and the derivatives of their first four entries by the
        state and by the elements (m - 1, 4, 4 + w + p).
    """
    steps, ids = np.diff(time), np.concatenate([walkers, columns])
    wandering = len(walkers)
    slope = np.zeros((len(steps), 4, 4 + len(ids)))
    slope[:, :, :4] = np.eye(4)
    state, whole, total = track[:-1, :4], np.zeros((len(steps), 4)), np.zeros_like(slope)
    speed, tangent = whole, np.zeros_like(slope)
    for share, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        reach = (share * steps)[:, None]
        fading = np.exp(-rates * reach)
        full = np.tile(elements, (len(steps), 1))
        for i, walker in enumerate(walkers):
            full[:, walker] += fading[:, i] * track[:-1, 4 + i]
        now = state + reach * speed
        moved = slope + reach[:, :, None] * tangent
        force, by_state, by_ids = acceleration(
            full, ids, now, time[:-1] + reach[:, 0],
            (1.0 - share) * thrust[:-1] + share * thrust[1:],
        )  # fmt: skip
        by_ids[:, :, :wandering] *= fading[:, None, :]
        speed = np.concatenate([now[:, 2:4], force], axis=1)
        tangent = np.concatenate([moved[:, 2:4], by_state @ moved], axis=1)
        tangent[:, 2:, 4:] += by_ids
        whole, total = whole + weight * speed, total + weight * tangent
    following = np.exp(-rates * steps[:, None]) * track[:-1, 4:]
    step = steps[:, None] / 6.0
    return (
        np.concatenate([state + step * whole, following], axis=1),
        slope + step[:, :, None] * total,
    )


def observation(
    elements: Array, walkers: IntArray, columns: IntArray, state: Array
) -> tuple[Array, Array, Array]:
    """Return the four readings of a state, H (4, 4 + w) and D (4, p).

    Args:
        elements: their values (22 + 5 j,).
        walkers: the elements that wander.
        columns: the elements to derive by.
        state: (4 + w,).
    """
    full = elements.copy()
    np.add.at(full, walkers, state[4:])
    place, rate, bias, turn = full[14], full[15], full[16:18], full[18]
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    seen = rotation @ state[2:4]
    reading = np.concatenate([place * state[:2] + full[20:22], rate * seen + bias])
    derivative = np.zeros((4, len(full)))
    derivative[:2, 14] = state[:2]
    derivative[2:, 15] = seen
    derivative[2, 16] = derivative[3, 17] = derivative[0, 20] = derivative[1, 21] = 1.0
    derivative[2:, 18] = rate * seen[1] * -1.0, rate * seen[0]
    derivative[:2, 19] = -place * state[2:4]
    by_state = np.zeros((4, len(state)))
    by_state[:2, :2] = place * np.eye(2)
    by_state[2:, 2:4] = rate * rotation
    by_state[:, 4:] = derivative[:, walkers]
    return reading, by_state, derivative[:, columns]


def forward(
    elements: Array, walkers: IntArray, rates: Array, columns: IntArray,
    kicks: Array, noise: Array,
    time: Array, thrust: Array, measured: Array, weights: Array, track: Array,
    adjoint: Array, scores: Array, state: Array, stored: Array | None,
) -> float:  # fmt: skip
    """Filter a block of nodes and carry the state on to the next block's first node.

    Args:
        elements, walkers, rates, columns: as of `transitions`.
        kicks: the variance per second that each level gives to each state (l, n).
        noise: the variance that each level gives to each channel (l, 4).
        time, thrust, track: of the block's m nodes and the one after them, if any: (m or m + 1).
        measured: the readings (m, 4).
        weights: by which the variance of each reading is divided (m, 4); 0: it is missing.
        adjoint: r before and after each node (m + 1, 2 n) of the last backward pass, which the
            columns of the levels need; of no rows: there are none.
        scores: the scores u (m, 12) of the readings of that pass.
        state: delta, V, P, then b and J as rows (n + q + n + 1 + q, width): changed in place.
        stored: what the backward pass reads (m, ...), written in place; None: not wanted.

    Returns:
        The log-likelihood of the block at dtheta = 0, -inf where rounding has won.
    """
    p, n = len(columns), 4 + len(walkers)
    levels = len(kicks) if len(adjoint) else 0
    q = p + levels
    delta, sensitivity, covariance = (
        state[0, :n],
        state[1 : 1 + q, :n],
        state[1 + q : 1 + q + n, :n],
    )
    score, information = state[1 + q + n, :q], state[2 + q + n : 2 + q + n + q, :q]
    following, slopes = transitions(elements, walkers, rates, columns, time, thrust, track)
    kick, spread = kicks.sum(axis=0), noise.sum(axis=0)
    total, inputs = 0.0, np.zeros((4, q))
    for i in range(len(measured)):
        if stored is not None:
            stored[i, : n * (1 + p + n)] = np.concatenate(
                [delta, sensitivity[:p].ravel(), covariance.ravel()]
            )
            gains = stored[i, n * (1 + p + n) :]
            gains[: 4 * (2 * n + p + 2)] = 0.0
        reading, by_state, inputs[:, :p] = observation(elements, walkers, columns, track[i])
        for channel in range(4):
            if weights[i, channel] <= 0.0:
                continue
            h, variance = by_state[channel], spread[channel] / weights[i, channel]
            if levels:
                inputs[channel, p:] = noise[:, channel] * scores[i, channel] / weights[i, channel]
            gain = covariance @ h
            size = gain @ h + variance
            if not size > 0.0:  # the covariance has lost its sign
                return -math.inf
            innovation = measured[i, channel] - reading[channel] - h @ delta
            response = inputs[channel] + sensitivity @ h
            if stored is not None:
                place = channel * (2 * n + p + 2)
                gains[place : place + 2 * n + p + 2] = np.concatenate(
                    [h, gain / size, response[:p], [innovation, size]]
                )
            delta += gain * (innovation / size)
            sensitivity -= np.outer(response, gain / size)
            covariance -= np.outer(gain, gain / size)
            score += response * (innovation / size)
            information += np.outer(response, response / size)
            total -= 0.5 * (innovation**2 / size + math.log(2.0 * math.pi * size))
        if i + 1 == len(time):
            break
        step = time[i + 1] - time[i]
        if levels:
            sensitivity[p:] += 0.5 * step * kicks * adjoint[i, n:]
        covariance[np.diag_indices(n)] += 0.5 * step * kick
        matrix = np.zeros((n, n))
        matrix[:4] = slopes[i, :, :n]
        matrix[range(4, n), range(4, n)] = np.exp(-rates * step)
        delta[:] = matrix @ delta + following[i] - track[i + 1]
        sensitivity[:] = sensitivity @ matrix.T
        sensitivity[:p, :4] += slopes[i, :, n:].T
        covariance[:] = matrix @ covariance @ matrix.T
        covariance[np.diag_indices(n)] += 0.5 * step * kick
        if levels:
            sensitivity[p:] += 0.5 * step * kicks * adjoint[i + 1, :n]
        if stored is not None:
            stored[i, -4 * n :] = matrix[:4].ravel()
    return total


def backward(
    rates: Array, columns: int, time: Array, weights: Array, change: Array, noise: Array,
    stored: Array, carried: Array, smoothed: Array, adjoint: Array, scores: Array, sums: Array,
) -> None:  # fmt: skip
    """Run the adjoint through a block, from its last node to its first.

    Args:
        rates: of the walkers (w,).
        columns: their number p.
        time: of the block's nodes and the one after them, if any.
        weights: of the readings (m, 4).
        change: dtheta (p,) of the columns' elements.
        noise: the variance of each channel (4,).
        stored: what `forward` wrote.
        carried: r and N of the node after the block (1 + n, n): changed in place.
        smoothed: delta given all measurements (m, n), written.
        adjoint: r at each node and after it (m, 2 n), written.
        scores: of the readings (m, 12), written: u, then the residual that each leaves when it is
            left out over its deviation, u/sqrt(D), then the standardised innovation e/sqrt(S).
        sums: (n, 2) sums of r^2 and of N over the half kicks, times their seconds, then (4, 2) of
            R u^2 and of R times its variance over the readings: added to.
    """
    n, p = carried.shape[1], columns
    r, covariance = carried[0], carried[1:]
    width = 2 * n + p + 2
    for i in range(len(weights) - 1, -1, -1):
        if i + 1 < len(time):
            step = time[i + 1] - time[i]
            sums[:n] += 0.5 * step * np.column_stack([r**2, np.diag(covariance)])
            matrix = np.zeros((n, n))
            matrix[:4] = stored[i, -4 * n :].reshape(4, n)
            matrix[range(4, n), range(4, n)] = np.exp(-rates * step)
            r[:] = matrix.T @ r
            covariance[:] = matrix.T @ covariance @ matrix
            sums[:n] += 0.5 * step * np.column_stack([r**2, np.diag(covariance)])
        adjoint[i, n:] = r
        gains = stored[i, n * (1 + p + n) :]
        scores[i] = 0.0
        for channel in range(3, -1, -1):
            if weights[i, channel] <= 0.0:
                continue
            part = gains[channel * width : (channel + 1) * width]
            h, gain, response = part[:n], part[n : 2 * n], part[2 * n : 2 * n + p]
            innovation, size = part[-2] - response @ change, part[-1]
            along = covariance @ gain
            u, spread = innovation / size - gain @ r, 1.0 / size + gain @ along
            scores[i, channel::4] = u, u / math.sqrt(spread), innovation / math.sqrt(size)
            r += h * u
            covariance += spread * np.outer(h, h) - np.outer(h, along) - np.outer(along, h)
            variance = noise[channel] / weights[i, channel]
            sums[n + channel] += variance * u * u, variance * spread
        adjoint[i, :n] = r
        delta, sensitivity = stored[i, :n], stored[i, n : n * (1 + p)].reshape(p, n)
        predicted = stored[i, n * (1 + p) : n * (1 + p + n)].reshape(n, n)
        smoothed[i] = delta + change @ sensitivity + predicted @ r
