"""The compiled kernels, one typed source each.

They are optional: without Cython, scipy or a C compiler plain numpy does the same, slower. All
keep to the stable interface, so one wheel a platform.
"""

import os

from setuptools import Extension, setup

TYPED = (
    *("likelihood/passes", "solvers/homotopy", "solvers/variances", "solvers/sweeps"),
)  # sparsefit/NAME.pyx
STABLE = {
    # No debugging symbols; the root and the comparisons of a loop are vectorised, too.
    "extra_compile_args": (
        [] if os.name == "nt" else ["-g0", "-O3", "-fno-math-errno", "-fno-trapping-math"]
    ),
    "define_macros": [("Py_LIMITED_API", "0x030b0000")],
    "py_limited_api": True,
    "optional": True,
}


def kernels() -> list[Extension]:
    """The kernels in C, or none where there is no Cython, or no scipy, whose BLAS they call."""
    try:
        import scipy.linalg  # noqa: F401
        from Cython.Build import cythonize
    except ImportError:
        return []
    extensions = cythonize(
        [
            Extension(
                f"sparsefit.{name.replace('/', '.')}",
                [f"sparsefit/{name}.pyx"],
                **STABLE,
            )
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


setup(ext_modules=kernels(), options={"bdist_wheel": {"py_limited_api": "cp311"}})
