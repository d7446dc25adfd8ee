"""The compiled loops: `.pyx` beside a NumPy reference, and Python sources with types beside them.

They are optional: without Cython, scipy or a C compiler the same sources run interpreted, slower.
All keep to the stable interface, so one wheel a platform.
"""

import os

from setuptools import Extension, setup

LOOPS = (
    *("active_set", "homotopy_point", "homotopy_walk"),
    *("variational_step", "variational_point", "variational_search"),
)  # sparsefit/backends/NAME.py, typed by compiled/NAME.pxd
TYPED = ("likelihood/passes", "solvers/sweeps")  # sparsefit/NAME.pyx, beside a plain reference
KERNELS = ("regression._gram",)  # C
STABLE = {
    "extra_compile_args": [] if os.name == "nt" else ["-g0"],  # no debugging symbols
    "define_macros": [("Py_LIMITED_API", "0x030b0000")],
    "py_limited_api": True,
    "optional": True,
}


def loops() -> list[Extension]:
    """The loops in C, or none where there is no Cython, or no scipy, whose BLAS they call."""
    try:
        import scipy.linalg  # noqa: F401
        from Cython.Build import cythonize
    except ImportError:
        return []
    folder = "sparsefit/backends"
    extensions = cythonize(
        [
            Extension(
                f"sparsefit.backends.compiled.{name}",
                [f"{folder}/{name}.py"],
                include_dirs=[f"{folder}/compiled"],
                depends=[f"{folder}/compiled/dense.h"],
                **STABLE,
            )
            for name in LOOPS
        ]
        + [
            Extension(f"sparsefit.{name.replace('/', '.')}", [f"sparsefit/{name}.pyx"], **STABLE)
            for name in TYPED
        ]
        + [
            Extension(  # the C that flies, in doubles
                "sparsefit.onboard.compiled",
                ["sparsefit/onboard/compiled.pyx", "sparsefit/onboard/templates/sf_flow.c"],
                include_dirs=["sparsefit/onboard/templates"],
                depends=["sparsefit/onboard/templates/sf_flow.h"],
                **STABLE,
            )
        ],
        build_dir="build",
        compiler_directives={
            "language_level": 3,
            "annotation_typing": False,
            "boundscheck": False,
            "wraparound": False,
            "initializedcheck": False,
            "cdivision": True,
            "infer_types": True,
        },
    )
    for extension in extensions:
        extension.optional = True  # which cythonize does not hand on
    return extensions


setup(
    ext_modules=[
        *loops(),
        *(
            Extension(f"sparsefit.{name}", [f"sparsefit/{name.replace('.', '/')}.c"], **STABLE)
            for name in KERNELS
        ),
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
