"""adelie as a command: it needs numpy < 2, and so an environment of its own.

    python3.11 -m venv adelie-env
    adelie-env/bin/pip install adelie scipy

In a study file: command = ["adelie-env/bin/python", "solvers/adelie_solver.py"]
"""

import json
import sys
from pathlib import Path

import adelie
import numpy as np
from scipy import sparse

folder = Path(sys.argv[1])
problem = json.loads((folder / "problem.json").read_text())
target = np.load(folder / "target.npy")
groups = np.load(folder / "groups.npy")
if (folder / "lambdas.npy").exists():
    sys.exit("adelie does not solve this penalty")

order = np.argsort(groups, kind="stable")  # adelie's groups are neighbours
starts = np.searchsorted(groups[order], np.arange(groups.max() + 1))
if (folder / "design.npy").exists():
    design = np.asfortranarray(np.load(folder / "design.npy")[:, order])
else:
    columns = sparse.load_npz(folder / "design.npz")[:, order]
    design = adelie.matrix.sparse(sparse.csc_matrix(columns))  # it takes no sparse arrays
joint = target.shape[1] > 1
glm = adelie.glm.multigaussian(y=target) if joint else adelie.glm.gaussian(y=target[:, 0])
scale = target.shape[1]  # its mean square is over samples and targets
ridge = problem["ridge"]

print("ready", flush=True)
sys.stdin.readline()
state = adelie.grpnet(
    X=design,
    glm=glm,
    groups=starts,
    lmda_path=np.array(problem["fractions"]) * (1.0 + ridge) / scale,
    alpha=1.0 / (1.0 + ridge),
    penalty=np.ones(len(starts)),
    intercept=False,
    early_exit=False,
    tol=1e-3 * (problem["tolerance"] or 1e-9),  # of a step: gaps are up to a thousand times it
    max_iters=1_000_000,
    n_threads=1,
    progress_bar=False,
    **problem["settings"],
)
print("done", flush=True)

answer = np.zeros((len(problem["fractions"]), target.shape[1], len(groups)))
betas = state.betas.toarray()
if joint:  # (p, k b), target by target of each column
    answer[:, :, order] = betas.reshape(len(betas), len(groups), -1).transpose(0, 2, 1)
else:
    answer[:, 0, order] = betas
np.save(folder / "answer.npy", answer)
