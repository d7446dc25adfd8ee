"""Small data files and study files of ``kind = "solvers"`` that several tests share."""

import numpy as np

HEAD = 'name = "small"\nkind = "solvers"\n'
LASSO = '[[backends]]\nname = "lasso"\nsolver = ["homotopy", "clarabel-direct", "adelie"]\n'
STLSQ = '[[backends]]\nname = "stlsq"\nmode = "pysindy"\nthreshold = 0.2\n'


def write_data(folder, name="one", seed=0, samples=30, columns=6, targets=1, **more):
    """An .npz file of random numbers in a folder."""
    draw = np.random.default_rng(seed)
    theta = draw.standard_normal((samples, columns))
    target = theta[:, :2] @ draw.standard_normal((2, targets)) + 0.3 * draw.standard_normal(
        (samples, targets)
    )
    np.savez(folder / f"{name}.npz", **({"theta": theta, "target": target} | more))


def write_study(folder, text):
    """A study file in a folder; its path."""
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path
