"""The C of a plan: the pieces of `templates/` that it needs, with its numbers in their places."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from importlib.resources import files
from string import Template

import sparsefit
from sparsefit.arrays import Array
from sparsefit.backends.lasso import Lasso
from sparsefit.backends.stlsq import STLSQ
from sparsefit.codec import plain
from sparsefit.export.layout import constants, ram
from sparsefit.export.model import GENERATED
from sparsefit.export.pieces import (
    COLUMNS,
    ESTIMATE,
    PAIRS,
    STEP_TEST,
    STEP_TUNABLE,
    SWEEPS,
    UNBIAS,
)
from sparsefit.export.plan import COARSE, END, STEPS, Plan

READ = ("length_scale", "mean_velocity", "refine", "precision")  # of a readout, on board
WIDTH = 96  # of a table of numbers
MATH = ("sin", "cos", "sqrt", "fabs", "log")
READOUTS = {  # of a scale's weights w: in words, as a sum, and what it has to exceed
    "group-norm": ("sum of squared weights", "w * w", "SF_R(0)"),
    "absolute-sum": ("sum of the weights' moduli", "${fabs}(w)", "SF_R(0)"),
    "signed-sum": ("sum of weights", "w", "SF_R(-HUGE_VAL)"),
}


def filled(name: str, values: Mapping[str, object]) -> str:
    """A file of `templates/` with its placeholders replaced."""
    text = files("sparsefit.export").joinpath("templates", name).read_text("utf-8")
    return Template(text).substitute(values)


def in_comment(text: str, most: int = 90) -> str:
    """Text as it may stand in a comment of C, on one line: nothing in it ends the comment."""
    words = "".join(one if " " <= one <= "~" else "?" for one in " ".join(text.split()))
    words = words.replace("\\", "/")
    for pair in ("*/", "/*", "??"):
        while pair in words:
            words = words.replace(pair, pair[0] + " " + pair[1])
    return words if len(words) <= most else words[: most - 3] + "..."


def table(values: Array) -> str:
    """Rows of literals for an initialiser, exact as doubles."""
    return "\n".join(_lines(f"SF_R({value!r})" for value in values.tolist())).removesuffix(",")


def _lines(items: Iterable[str]) -> list[str]:
    lines = ["   "]
    for item in items:
        if len(lines[-1]) + len(item) + 2 > WIDTH:
            lines.append("   ")
        lines[-1] += f" {item},"
    return lines


def header(plan: Plan, told: dict[str, str]) -> str:
    """sf_flow.h.

    told: ``source``, ``flash``, ``stack``, ``work`` and ``budget``, in words for its first comment.
    """
    library, tuning = plan.estimator.library, GENERATED
    grid = {key: value for key, value in plain(library.grid).items() if key != "fraction"}
    readout, derivative = plain(plan.estimator.readout), plain(plan.derivative)
    del derivative["repair"]  # there is none on board
    step = STEP_TUNABLE["savgol" if plan.derivative.method == "savgol" else "gap"]
    sizes = COLUMNS if plan.columns else dict.fromkeys(COLUMNS, "")
    settings: dict[str, str] = {
        "derivative": _settings("", derivative),
        "library": _settings("cells", grid | {"every": library.every}),
        "backend": _settings(plan.backend.name, plain(plan.backend)),
        "readout": _settings("", {name: readout[name] for name in READ}),
    }
    values: dict[str, object] = {name: in_comment(words) for name, words in settings.items()}
    return filled(
        "sf_flow.h",
        values
        | {
            "version": sparsefit.__version__,
            "scales": len(plan.scales),
            "lower": f"{plan.scales[0]:g}",
            "upper": f"{plan.scales[-1]:g}",
            "ram": ram(plan),
            "constants": constants(plan),
            "real": plan.real,
            "tunable_count": 5 if isinstance(plan.backend, Lasso) else 4,
            "minimum_rows": tuning.minimum_rows,
            "block": tuning.block,
            "step_tunable": Template(step).substitute(
                step_tolerance=tuning.step_tolerance, longest_step=tuning.longest_step
            ),
            "sweep_tunable": ""
            if not isinstance(plan.backend, Lasso)
            else Template(SWEEPS).substitute(sweeps=tuning.sweeps),
            "orders": plan.orders,
            "orders_why": "to go between the scales" if plan.refined else "values alone",
            "window": plan.window,
            "every": library.every,
            "column_sizes": sizes["column_sizes"],
            "column_state": sizes["column_state"],
            "certificate": _certificate(plan),
            "precision": f"{plan.precision:g}",
            "estimate_const": "" if plan.columns else "const ",
        }
        | told,
    )


def body(plan: Plan) -> str:
    """sf_flow.c."""
    method = plan.derivative.method
    rows = ["rows_savgol.c"] if method == "savgol" else ["seconds.c", "rows_central.c"]
    if method in PAIRS:
        rows[-1] = "rows_pair.c"
    parts = ["head.c", *rows, "scales.c", "tell.c"]
    if plan.columns:
        parts += ["columns.c", f"choice_{plan.backend.name}.c"]
    elif not plan.refined:
        parts.append("answer_least.c")
    parts += ["refine.c", "answer_refined.c"] if plan.refined else ["answer_grid.c"]
    values = _numbers(plan) | _settings_of(plan) | _hooks(plan)
    return "".join(filled(part, values) for part in [*parts, "api.c"])


def functions(plan: Plan) -> dict[str, str]:
    """The functions of math.h for the plan's type, by their names for doubles."""
    return {name: name + ("f" if plan.real == "float" else "") for name in MATH}


def _numbers(plan: Plan) -> dict[str, str]:
    names = (
        *("floor", "rounding", "settled", "correlation", "detection", "distinct"),
        *("precision", "safe", "largest"),
    )
    return {name: repr(float(getattr(plan, name))) for name in names} | {
        "version": sparsefit.__version__,
        "wavenumbers": table(plan.wavenumbers),
        "window": str(plan.window),
        "steps": str(STEPS[plan.real]),
        "end": repr(END[plan.real]),
        "coarse": repr(COARSE),
        "resolved": repr(2 * math.pi * COARSE),
    }


def _settings_of(plan: Plan) -> dict[str, str]:
    """The numbers of the derivative and of the back-end."""
    backend, values = plan.backend, dict[str, str]()
    if plan.derivative.method == "savgol":
        value, slope = plan.kernels
        order = str(plan.derivative.order)
        values |= {"order": order, "value_kernel": table(value), "slope_kernel": table(slope)}
    if isinstance(backend, Lasso):
        values["alpha_fraction"] = repr(float(backend.alpha_fraction))
    if isinstance(backend, STLSQ):
        assert backend.threshold is not None
        values |= {
            "threshold": repr(float(backend.threshold)),
            "ridge": repr(float(backend.ridge)),
            "iterations": str(backend.max_iterations),
            "unbias_words": ";\n * then a least squares on what stays" if backend.unbias else "",
            "unbias": UNBIAS if backend.unbias else "",
        }
    return values


def _hooks(plan: Plan) -> dict[str, str]:
    """What the back-end and the derivative add to the pieces that all estimators share."""
    words, summed, least = READOUTS[plan.estimator.readout.length_scale]
    step = STEP_TEST["savgol" if plan.derivative.method == "savgol" else "gap"]
    own, math = bool(plan.columns), functions(plan)
    answer = "columns" if own else "refined" if plan.refined else "least"
    pair_words, pair_state = PAIRS.get(plan.derivative.method, ("", ""))
    return (
        (COLUMNS if own else dict.fromkeys(COLUMNS, ""))
        | math
        | {
            "readout_words": words,
            "readout_sum": Template(summed).substitute(math),
            "least_weight": least,
            "step_test": Template(step).substitute(math),
            "estimate_const": "" if own else "const ",
            "pair_words": f"{pair_words} ".ljust(82, "-"),
            "pair_state": pair_state,
            "estimate_body": Template(ESTIMATE[answer]).substitute(
                candidate="" if plan.refined else "scale, "
            ),
        }
    )


def _certificate(plan: Plan) -> str:
    if isinstance(plan.backend, Lasso):
        return "duality gap in units of |Phi|^2/2m: nothing better is further away"
    if isinstance(plan.backend, STLSQ):
        return "share of the columns that the last iterations still removed"
    return "none: NaN"


def _settings(name: str, values: Mapping[str, object]) -> str:
    told = " ".join(f"{key}={value}" for key, value in values.items() if value is not None)
    return f"{name} {told}".strip()
