"""Fits of modes to rows, by Gauss-Newton from where they should be."""

import numpy as np

from sparsefit.library.cells import Cells
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project
from sparsefit.uncertainty.model import Model

STEPS = 30


def located(rows, start, family=None):
    """The projection at the parameters that fit best, from a start (s, p)."""
    family, parameters = family or Cells(), np.array(start, dtype=float)
    fit = project(family, rows, parameters)
    for _ in range(STEPS):
        if np.abs(fit.moves).max() <= 1e-15 * np.abs(parameters).max():
            break
        parameters = parameters + fit.moves
        fit = project(family, rows, parameters)
    return fit


def cells_at(rows, wavenumber):
    """The model of one mode of cells at a wavenumber [1/m]."""
    return Model.of(Cells(), rows, project(Cells(), rows, np.array([[wavenumber]])))


def plain_model(position, flow_velocity, wavenumber):
    """The same, of samples of Phi (m, 2) [m/s] at positions (m, 2) [m]."""
    return cells_at(Rows.plain(position, flow_velocity), wavenumber)
