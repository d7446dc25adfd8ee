"""Designs of every kind against plain products of one array."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

import sparsefit as sf
from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.regression.design import Design
from sparsefit.regression.problem import RegressionProblem

M, K = 60, 9
DRAW = np.random.default_rng(3)
THETA = np.where(DRAW.random((M, K)) < 0.6, DRAW.normal(size=(M, K)) + 1.0, 0.0) * np.arange(1, 10)
WEIGHTS = DRAW.uniform(0.5, 2.0, M)
DIRECTION = WEIGHTS / np.linalg.norm(WEIGHTS)


class Rows:
    """Rows that can only be sliced, as a file of them."""

    shape = (M, K)

    def __getitem__(self, rows: slice) -> Array:
        return THETA[rows]


def source_of(kind: str, folder: Path, block: int) -> object:
    if kind == "file":
        np.save(folder / "theta.npy", THETA)
        return np.load(folder / "theta.npy", mmap_mode="r")
    if kind == "dask":
        return pytest.importorskip("dask.array").from_array(THETA, chunks=(block, K))
    sources = {"rows": THETA, "columns": np.asfortranarray(THETA), "slices": Rows()}
    return sources.get(kind, sparse.csc_array(THETA))


def check(design: Design, theta: Array) -> None:
    rms = np.sqrt(np.mean(theta**2, axis=0))
    z, values = theta / rms, np.zeros((K, 3))
    values[[2, 5]] = DRAW.normal(size=(2, 3))
    rows, index = DRAW.normal(size=(M, 3)), np.array([7, 0, 3])
    assert design.shape == (M, K)
    assert np.allclose(design.rms, rms, rtol=1e-12)
    for dense in (values, np.ones((K, 3))):
        assert np.allclose(design.predict(dense), z @ dense)
    assert np.allclose(design.correlate(rows), z.T @ rows / M)
    assert np.allclose(design.columns(index), z[:, index])
    gram = z.T @ z / M
    assert np.allclose(design.products(slice(None)), gram)
    assert np.allclose(design.products(index), gram[np.ix_(index, index)])
    assert np.allclose(design.products(index, slice(None)), gram[index])


@pytest.mark.parametrize("kind", ["rows", "columns", "file", "slices", "sparse", "dask"])
@pytest.mark.parametrize("change", ["plain", "weighted", "centred"])
@pytest.mark.parametrize("block", [8192, 7])
def test_every_kind_is_the_array_that_it_is(
    kind: str, change: str, block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sparsefit.regression.design.ROW_BLOCK", block)
    monkeypatch.setattr("sparsefit.regression.design.BLOCK_BYTES", 8 * K * block)
    source: Any = source_of(kind, tmp_path, block)
    if change == "plain":
        check(Design(source, M), THETA)
    elif change == "weighted":
        check(Design(source, M, WEIGHTS), THETA * WEIGHTS[:, None])
    else:
        off = THETA - np.multiply.outer(DIRECTION, DIRECTION @ THETA)
        check(Design(source, M, direction=DIRECTION), off)


@pytest.mark.parametrize("kind", ["rows", "columns", "file", "slices", "sparse", "dask"])
def test_only_what_is_in_memory_has_a_digest(kind: str, tmp_path: Path) -> None:
    source: Any = source_of(kind, tmp_path, 8192)
    assert bool(Design(source, M).digest()) == (kind in ("rows", "columns", "sparse"))


def test_a_file_of_single_precision_is_read_as_it_is(tmp_path: Path) -> None:
    np.save(tmp_path / "theta.npy", THETA.astype(np.float32))
    stored = np.load(tmp_path / "theta.npy", mmap_mode="r")
    fit = sf.fit(RegressionProblem.from_arrays(stored, THETA[:, 0]), "lasso")
    again = sf.fit(RegressionProblem.from_arrays(np.asarray(stored, float), THETA[:, 0]), "lasso")
    assert fit.status == "ok"
    np.testing.assert_allclose(fit.weights, again.weights, rtol=1e-9)


def test_rounding_grows_with_blocks_and_means(monkeypatch: pytest.MonkeyPatch) -> None:
    tall = Design(np.ones((100_000, 1)), 100_000)
    assert tall.terms == 8192 + 12
    monkeypatch.setattr("sparsefit.regression.design.BLOCK_BYTES", 8 * K * 20)
    monkeypatch.setattr("sparsefit.regression.design.SUMMED", 4)
    assert Design(Rows(), M).terms == 20 + 2  # three blocks of 20 rows of eight bytes a number
    shifted = Design(DRAW.normal(size=(50, 2)) + np.array([0.0, 1e3]), 50)
    assert 300 < replace(shifted, direction=np.full(50, 50**-0.5)).spread < 3000
    assert Design(sparse.csc_array(np.eye(9)), 9).terms == 4 + 2  # of squares of a target


def test_a_column_that_is_constant_is_zero_when_centred() -> None:
    theta = np.column_stack([np.full(50, 0.1), np.arange(50.0)])
    centred = Design(theta, 50, direction=np.full(50, 50**-0.5))
    assert centred.squares[0] == 0.0
    assert centred.rms[1] == pytest.approx(np.std(np.arange(50.0)))


def test_a_gram_matrix_of_too_many_columns_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(*_anything: object) -> None:
        raise MemoryError

    monkeypatch.setattr(Design, "products", lacking)
    with pytest.raises(InputError, match=r"of 16384 columns takes 2\.0 GiB.*: use fewer columns"):
        _ = Design(np.ones((1, 2**14)), 1).gram
