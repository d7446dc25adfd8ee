"""Many flights at once, for tests that count over flights: one classical Runge-Kutta for all.

The simulator of the package flies one after another to 1e-11; this flies to about 1e-7, which noise
drowns, in a hundredth of the time.
"""

import numpy as np

import sparsefit as sf


def fly_together(flows, vehicle, *, duration, rate, seed, steps=4, **noise):
    """A flight of round(duration rate) + 1 samples through each of the flows, its first one told.

    flows: tuples of cellular flows that add up, as many in each; ``wind`` [m/s] carries all.
    steps: of the integration from sample to sample, each with a kick of the process noise.
    noise: wind, process_noise, position_noise, velocity_noise, as of `simulate_flight`.
    """
    wind = np.array(noise.pop("wind", (0.0, 0.0)))[:, None]
    process, measured = noise.pop("process_noise", 0.0), noise
    rng, m = np.random.default_rng(seed), round(duration * rate)
    k, speed = (
        np.array([[getattr(part, name) for part in parts] for parts in flows]).T
        for name in ("wavenumber", "mean_velocity")
    )
    thrust = np.array(vehicle.thrust_acceleration)[:, None]

    def slope(state):
        x, y = k * state[0], k * state[1]
        w = np.stack([speed * np.sin(x) * np.cos(y), -speed * np.cos(x) * np.sin(y)]).sum(axis=1)
        v = state[2:]
        return np.concatenate([v, (w + wind - v) / vehicle.response_time + thrust])

    h = 1.0 / (rate * steps)
    kicks = process / rate / np.sqrt(steps) * rng.standard_normal((m, steps, 2, len(flows)))
    state = np.zeros((4, len(flows)))
    state[:2] = rng.uniform(0, 2 * np.pi, (2, len(flows))) / k.min(axis=0)
    states = [state]
    for of_interval in kicks:
        for kick in of_interval:
            state = state + np.concatenate([np.zeros_like(kick), 0.5 * kick])
            a = slope(state)
            b = slope(state + 0.5 * h * a)
            c = slope(state + 0.5 * h * b)
            d = slope(state + h * c)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
            state = state + np.concatenate([np.zeros_like(kick), 0.5 * kick])
        states.append(state)
    position, velocity = np.split(np.stack(states).transpose(2, 0, 1), 2, axis=2)
    position = position + measured.get("position_noise", 0.0) * rng.normal(size=position.shape)
    velocity = velocity + measured.get("velocity_noise", 0.0) * rng.normal(size=velocity.shape)
    time = np.arange(m + 1) / rate
    flown = zip(position, velocity, flows, strict=True)
    return [sf.Flight(time, p, v, vehicle, parts[0]) for p, v, parts in flown]
