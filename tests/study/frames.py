"""Frames of cases and studies made by hand, in the columns that the plan and the runs give."""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd

from sparsefit.study.keys import Outputs, SelectionRule

TRUE = {"mean_velocity": 10.0, "length_scale": 5.0, "timescale": 0.5}


def case(flight=0, percent=(0.0, 0.0), status="ok", **more):
    """A case of U0 = 10 m/s and L = 5 m; percent: the errors of both, None for no estimate."""
    missing = percent is None
    speed, length = (math.nan, math.nan) if missing else percent
    u, scale = 10.0 * (1 + speed / 100), 5.0 * (1 + length / 100)
    row = {
        "flight": flight, "unit": f"{flight:04d}", "condition": "", "split": "all",
        "protocol": "paper", "reading": "", "backend": "lasso", "label": "lasso",
        "settings": "{}", "status": status, "reason": "", "flow": "cellular", "seconds": 0.01,
        "certificate": 1e-12, "certificate_kind": "duality_gap", "hit": True, "doubt": "",
        **{f"true_{name}": value for name, value in TRUE.items()},
        "est_mean_velocity": u, "est_length_scale": scale, "est_timescale": scale / u,
    } | more  # fmt: skip
    row.setdefault("title", row["label"])
    row.setdefault("candidate", row["title"])
    return row


def frame(*rows):
    cases = pd.DataFrame(rows)
    if "case_id" not in cases:
        cases["case_id"] = [f"{place:04d}-abc" for place in range(len(cases))]
    return cases


def spread(titles=("lasso", "stlsq"), flights=12, **more):
    rng = np.random.default_rng(1)
    return frame(*(
        case(flight, (rng.normal(0, 1 + place), rng.normal(0, 1)), label=title, **more)
        for place, title in enumerate(titles) for flight in range(flights)
    ))  # fmt: skip


def solve(problem, solver, seconds, excess=1e-12, status="ok", **more):
    return {
        "problem": problem, "solver": solver, "objective": "lasso", "wall": seconds,
        "cpu": seconds, "excess": excess, "status": status, "reason": "", "tolerance": math.nan,
        "samples": 100, "columns": 10, "first": 0.1, "memory": 3.0, "repeats": 9, "known": True,
        "disturbed": False, "title": solver, "candidate": f"lasso/{solver}", "condition": "",
        "flight": int(problem[1:]), "split": "all", "backend": "lasso", "label": solver,
        "settings": "{}", "case_id": f"{problem}-{solver}-{more.get('tolerance', '')}",
    } | more  # fmt: skip


def study(cases, *, tmp="", rule=None, **outputs):
    """A study of cases that are there, as the pages see it."""
    kind = "problems" if "objective" in cases else "flights"
    definition = SimpleNamespace(outputs=Outputs(**outputs), select=rule or select_rule())
    return SimpleNamespace(
        name="demo", question="Which?", path=f"{tmp}/demo.toml", seed=1, hash="ab" * 32, kind=kind,
        folder=tmp, cases=cases, definition=definition, latencies={}, plan=lambda: cases,
    )  # fmt: skip


def select_rule(**rule):
    return SelectionRule(**{"margin": 0.0, **rule})
