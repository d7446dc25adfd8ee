"""Ways to make a regression problem degenerate: where solvers differ in whether they answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array

Alter: TypeAlias = Callable[[Array, Array, np.random.Generator], tuple[Array, Array]]
"""(theta (m, k), target (m, n), random numbers) -> both, altered."""
AS_IT_IS = "as it is"


def _as_is(theta: Array, target: Array, _: np.random.Generator) -> tuple[Array, Array]:
    return theta, target


def _duplicated(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """A fifth of the columns replaced by copies, negatives and multiples of others."""
    theta, k = theta.copy(), theta.shape[1]
    count = max(1, k // 5)
    to, source = draw.choice(k, count, replace=False), draw.integers(0, k, count)
    theta[:, to] = theta[:, source] * draw.choice([-2.0, -1.0, 1.0, 3.0], count)
    return theta, target


def _nearly_dependent(
    theta: Array, target: Array, draw: np.random.Generator
) -> tuple[Array, Array]:
    """Columns that differ from others in the ninth digit."""
    theta, k = theta.copy(), theta.shape[1]
    to, source = draw.choice(k, k // 4, replace=False), draw.integers(0, k, k // 4)
    theta[:, to] = theta[:, source] + 1e-9 * draw.standard_normal((len(theta), k // 4))
    return theta, target


def _dead(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Columns that are zero in all samples but one."""
    theta = theta.copy()
    for column in draw.choice(theta.shape[1], theta.shape[1] // 8, replace=False):
        theta[:, column] = 0.0
        theta[draw.integers(len(theta)), column] = 1.0
    return theta, target


def _units(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Tiny and huge units, of each column and of the target."""
    scale = 10.0 ** draw.uniform(-12, 12, theta.shape[1])
    return theta * scale, target * 10.0 ** draw.uniform(-12, 12)


def _few(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Fewer samples than columns."""
    keep = draw.integers(4, max(5, min(theta.shape) // 2))
    return theta[:keep], target[:keep]


def _one_axis(theta: Array, target: Array, _: np.random.Generator) -> tuple[Array, Array]:
    """A last target of zeros."""
    target = target.copy()
    target[:, -1] = 0.0
    return theta, target


def _noise(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """A target that no column explains."""
    return theta, draw.standard_normal(target.shape)


ALTERATIONS: Mapping[str, Alter] = MappingProxyType(
    {
        AS_IT_IS: _as_is,
        "duplicated columns": _duplicated,
        "nearly dependent columns": _nearly_dependent,
        "dead columns": _dead,
        "units 1e-12 to 1e12": _units,
        "fewer samples than columns": _few,
        "a target of zeros": _one_axis,
        "a target of noise": _noise,
    }
)
"""Name, as a study file has it -> what is done to theta and target."""
