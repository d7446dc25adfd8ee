"""Times of solvers on problems of many shapes, to a certified gap; run by hand, not by pytest.

    python tests/benchmark_shapes.py --shape wide-500x5000 --objective lasso --solver exact celer

Each solver runs in a process of its own that is forked after the problem is made, and is killed at
the limit. It is run at ever smaller tolerances, until its objective is within 1e-8 of the best
certified lower bound of all solvers, in units of the objective at zero; that run counts, or else
its best. Seconds are of the CPU, everything charged, and a line of JSON a run goes to --output.
"""

import argparse
import json
import multiprocessing
import os
import resource
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues
from sparsefit.solvers.exact import exact_path
from sparsefit.solvers.registry import solver


@dataclass(frozen=True)
class Shape:
    """y = Z w + noise, Z of unit rms; neighbours correlated, or sparse (CSC) of a density below 1.

    active: columns, or whole groups, that w uses, with normal weights; noise: its rms over Z w's.
    """

    samples: int
    columns: int
    targets: int = 1
    correlation: float = 0.0
    density: float = 1.0
    group_size: int = 1
    active: int = 20
    noise: float = 0.1

    def draw(self, seed):
        rng = np.random.default_rng(seed)
        theta = self._sparse(rng) if self.density < 1.0 else self._dense(rng)
        groups = np.arange(self.columns) // self.group_size
        chosen = rng.choice(int(groups[-1]) + 1, size=self.active, replace=False)
        used = np.isin(groups, chosen)
        weights = np.zeros((self.columns, self.targets))
        weights[used] = rng.standard_normal((int(used.sum()), self.targets))
        signal = theta @ weights
        level = self.noise * np.sqrt(np.mean(np.square(signal), axis=0))
        return theta, signal + level * rng.standard_normal(signal.shape), groups

    def _dense(self, rng):
        theta, fresh = (
            np.empty((self.samples, self.columns), order="F"),
            np.sqrt(1 - self.correlation**2),
        )
        for j in range(self.columns):
            theta[:, j] = rng.standard_normal(self.samples)
            if j and self.correlation:
                theta[:, j] = self.correlation * theta[:, j - 1] + fresh * theta[:, j]
        theta /= np.sqrt(np.einsum("ij,ij->j", theta, theta) / self.samples)
        return theta

    def _sparse(self, rng):
        entries = np.maximum(rng.binomial(self.samples, self.density, self.columns), 1)
        starts = np.concatenate([[0], np.cumsum(entries)])
        drawn = [rng.choice(self.samples, size=count, replace=False) for count in entries]
        rows, values = (
            np.concatenate([np.sort(part) for part in drawn]),
            rng.standard_normal(starts[-1]),
        )
        squares = np.add.reduceat(np.square(values), starts[:-1])
        values /= np.repeat(np.sqrt(squares / self.samples), entries)
        return sparse.csc_matrix((values, rows, starts), shape=(self.samples, self.columns))


class Exact:
    """sparsefit's own paths."""

    stops = False

    def path(self, design, target, penalty, alphas, tolerance):
        return exact_path(design, target, penalty, alphas).weights


def named(name):
    return Exact() if name == "exact" else solver(name)


SHAPES = {
    "100x10000": Shape(100, 10_000, active=10),
    "500x5000": Shape(500, 5_000),
    "500x20000": Shape(500, 20_000),
    "1000x10000-.8": Shape(1_000, 10_000, correlation=0.8, active=50),
    "2000x2000-.9": Shape(2_000, 2_000, correlation=0.9, active=50),
    "1e6x100": Shape(1_000_000, 100, active=20, noise=1.0),
    "sparse-10000x50000": Shape(10_000, 50_000, density=1e-3, active=100),
    "sparse-100000x20000": Shape(100_000, 20_000, density=1e-3, active=100),
}
FLIGHTS = ("short-clean", "short-noisy", "medium-clean", "medium-noisy", "long-clean", "long-noisy")
LOWEST = {"1e-1": 1e-1, "1e-2": 1e-2, "1e-3": 1e-3}
TOLERANCES = (1e-8, 1e-10, 1e-12, 1e-14)
ACCURACY = 1e-8
PEERS = {
    "lasso": (
        "scikit-learn-lars",
        "spams",
        "scikit-learn-cd",
        "celer",
        "skglm",
        "glum",
        "sortedl1",
    ),
    "elastic-net": ("scikit-learn-cd", "celer", "skglm", "glum"),
    "group-lasso": ("celer", "skglm"),
    "joint": ("celer", "skglm"),
    "sparse-group": ("skglm", "asgl"),
    "slope": ("sortedl1", "skglm"),
}


def problem(shape, objective, seed, flights):
    """theta, target and groups of a shape; flights are read from the folder of their .npz files."""
    if shape in FLIGHTS:
        arrays = np.load(flights / f"{shape}.npz")
        return np.asfortranarray(arrays["theta"]), arrays["target"], arrays["groups"]
    if shape in ("digits", "diabetes"):
        from sklearn import datasets
        from sklearn.preprocessing import PolynomialFeatures

        X, y = getattr(datasets, f"load_{shape}")(return_X_y=True)
        Z = PolynomialFeatures(2, include_bias=False).fit_transform(X)
        Z = Z - Z.mean(axis=0)
        Z = Z[:, np.abs(Z).max(axis=0) > 1e-9]
        targets = (y - y.mean())[:, None] * np.ones((1, 1 + (objective == "joint")))
        return np.asfortranarray(Z), targets.astype(float), np.arange(Z.shape[1]) // 10
    settings = {"targets": 2} if objective == "joint" else {}
    if objective in ("group-lasso", "joint", "sparse-group"):
        settings |= {"group_size": 10, "active": max(SHAPES[shape].active // 10, 3)}
    fields = {**SHAPES[shape].__dict__, **settings}
    return Shape(**fields).draw(seed)


def as_design(theta):
    return Design(theta, theta.shape[0])


def penalty_of(objective, groups):
    columns, count = len(groups), int(groups.max()) + 1
    return {
        "lasso": lambda: AbsoluteValues(np.ones(columns)),
        "elastic-net": lambda: AbsoluteValues(np.ones(columns), ridge=0.1),
        "group-lasso": lambda: GroupNorms(groups, np.ones(count), together=False),
        "joint": lambda: GroupNorms(groups, np.ones(count)),
        "sparse-group": lambda: NestedNorms(
            GroupNorms(groups, 0.5 * np.ones(count), together=False),
            AbsoluteValues(0.5 * np.ones(columns)),
        ),
        "slope": lambda: SortedNorm(np.linspace(1.0, 0.2, columns)),
    }[objective]()


def bounds(design, target, weights, alphas, penalty):
    """Objectives P (p,) and certified lower bounds D (p,) of the points of a path."""
    gaps = duality_gaps(design, target, weights / design.rms[:, None], alphas, penalty)
    return np.array([c.primal for c in gaps]), np.array([c.dual for c in gaps])


def child(pipe, name, limit, theta, target, penalty, alphas, tolerance):
    """Solve, and send back seconds of CPU, megabytes above what was there, P and D."""
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, 1)
    os.dup2(devnull, 2)
    warnings.simplefilter("ignore")
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + limit) + 1, -1))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start = time.process_time()
        design = as_design(theta)
        weights = named(name).path(design, target, penalty, alphas, tolerance)
        seconds = time.process_time() - start
        memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3
        primal, dual = bounds(design, target, np.asarray(weights), alphas, penalty)
        active = int((np.asarray(weights)[-1] != 0).any(axis=1).sum())
        pipe.send((seconds, memory, primal, dual, active, ""))
    except BaseException as error:
        pipe.send((np.nan, np.nan, None, None, 0, repr(error)[:200]))


def run(name, limit, *arguments):
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=child, args=(theirs, name, limit, *arguments))
    process.start()
    theirs.close()
    try:
        answer = (
            ours.recv() if ours.poll(20 * limit) else (np.nan, np.nan, None, None, 0, "timeout")
        )
    except EOFError:
        answer = (np.nan, np.nan, None, None, 0, "killed at its limit")
    process.kill()
    process.join()
    return answer


def warm(names):
    """Import and compile what is timed, on a small problem, before it is forked."""
    drawn = Shape(40, 12, group_size=3, active=2, targets=2).draw(0)
    thin = Shape(400, 120, group_size=3, active=2, targets=2, density=0.05).draw(0)
    for objective, peers in PEERS.items():
        for name in set(peers) & set(names) | (
            set(names) - {p for ps in PEERS.values() for p in ps}
        ):
            for each in (drawn, thin):
                theta, target, groups = each
                penalty, design = penalty_of(objective, groups), as_design(theta)
                alpha = penalty.dual_norm(design.correlate(target)).max()
                alphas = alpha * np.array([1.0, 0.5])
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    try:
                        named(name).path(design, target, penalty, alphas, 1e-6)
                    except Exception as error:
                        print("warm", objective, name, repr(error)[:100], file=sys.stderr)


def compare(shape, objective, lowest, seed, names, limit, flights, output):
    theta, target, groups = problem(shape, objective, seed, flights)
    penalty, design = penalty_of(objective, groups), as_design(theta)
    largest = float(penalty.dual_norm(design.correlate(target)).max())
    alphas = largest * np.geomspace(1.0, LOWEST[lowest], 30)
    null = float(np.square(target).sum()) / (2 * len(target))
    best, results = np.full(len(alphas), -np.inf), {}
    for name in names:
        for tolerance in TOLERANCES:
            answer = run(name, limit, theta, target, penalty, alphas, tolerance)
            seconds, memory, primal, dual, active, error = answer
            gap = np.inf
            if primal is not None:
                best = np.maximum(best, np.where(np.isfinite(dual), dual, -np.inf))
                gap = float(np.max(primal - best)) / null
                own = float(np.max(primal - dual)) / null
            record = {
                "shape": shape, "objective": objective, "lowest": lowest, "seed": seed,
                "solver": name, "tolerance": tolerance, "seconds": seconds, "gap": gap,
                "own": own if primal is not None else None,
                "megabytes": memory, "active": active, "error": error,
            }  # fmt: skip
            with output.open("a") as file:
                file.write(json.dumps(record) + "\n")
            if name not in results or gap < results[name][1] or gap <= ACCURACY:
                results[name] = (seconds, gap, tolerance, error)
            if gap <= ACCURACY or error or not getattr(named(name), "stops", True):
                break
    for name, (seconds, gap, tolerance, error) in results.items():
        mark = "" if gap <= ACCURACY else " *"
        print(f"{shape:22} {objective:12} {lowest:5} {seed} {name:18} {seconds:9.3f} s "
              f"{gap:8.1e}{mark} tol {tolerance:g} {error}", flush=True)  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shape", nargs="+", default=[*SHAPES, "digits", "diabetes", *FLIGHTS])
    parser.add_argument("--objective", nargs="+", default=list(PEERS))
    parser.add_argument("--lowest", nargs="+", default=list(LOWEST))
    parser.add_argument("--seed", nargs="+", type=int, default=[0])
    parser.add_argument("--solver", nargs="+", default=None, help="default: all peers and exact")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of CPU a run")
    parser.add_argument("--flights", type=Path, default=Path("flights"))
    parser.add_argument("--output", type=Path, default=Path("benchmark.jsonl"))
    given = parser.parse_args()
    every = {name for objective in given.objective for name in PEERS[objective]} | {"exact"}
    warm(every if given.solver is None else set(given.solver))
    for shape in given.shape:
        for objective in given.objective:
            names = given.solver or [*PEERS[objective], "exact"]
            for lowest in given.lowest:
                for seed in given.seed:
                    compare(shape, objective, lowest, seed, names, given.limit, given.flights,
                            given.output)  # fmt: skip


if __name__ == "__main__":
    main()
