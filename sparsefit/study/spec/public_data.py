"""Regression data that ship inside scikit-learn: public problems without a download.

``diabetes``: 442 patients, 10 columns; ``diabetes-quadratic``: the 64 predictors of Efron, Hastie,
Johnstone and Tibshirani (Ann. Statist. 32, 2004), each variable's square in its group;
``linnerud``: 20 athletes, 3 exercises, 3 targets. Columns and targets are centred, as there is no
intercept.
"""

from __future__ import annotations

import itertools
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import MissingExtra, one_of
from sparsefit.study.spec.data_files import Arrays

DATASETS = ("diabetes", "diabetes-quadratic", "linnerud")


def read_public(name: str) -> Arrays:
    """The arrays of a public data set.

    Raises:
        InputError: on an unknown name.
        MissingExtra: where scikit-learn is not installed.
    """
    one_of("data set", name, DATASETS)
    try:
        datasets: Any = import_module("sklearn.datasets")
    except ImportError:
        remedy = "pip install 'sparsefit[peers]'"
        raise MissingExtra(f'data set "{name}" ships with scikit-learn: {remedy}') from None
    load = datasets.load_linnerud if name == "linnerud" else datasets.load_diabetes
    theta, target = load(return_X_y=True)
    theta, target = _centred(np.asarray(theta, float)), _centred(np.asarray(target, float))
    if name != "diabetes-quadratic":
        return theta, target, None
    columns, groups = _quadratic(theta)
    return columns, target, groups


def _quadratic(theta: Array) -> tuple[Array, Array]:
    """Variables, their squares (but of sex, which has two values) and products; and groups."""
    squared = [j for j in range(theta.shape[1]) if len(np.unique(theta[:, j])) > 2]
    pairs = list(itertools.combinations(range(theta.shape[1]), 2))
    parts = [theta, theta[:, squared] ** 2]
    parts.append(np.column_stack([theta[:, i] * theta[:, j] for i, j in pairs]))
    products = theta.shape[1] + np.arange(len(pairs))
    groups = np.concatenate([np.arange(theta.shape[1]), squared, products])
    columns = _centred(np.hstack(parts))
    return columns / columns.std(axis=0), groups


def _centred(values: Array) -> Array:
    centred: Array = values - values.mean(axis=0)
    return centred
