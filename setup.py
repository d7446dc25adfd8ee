"""The compiled loops: one small C module each, of the stable interface, so one wheel a platform.

They are optional: without a C compiler the same algorithms run in Python, slower.
"""

from glob import glob

from setuptools import Extension, setup

LOOPS = ("_homotopy", "_variational")  # sparsefit/backends/NAME.c
KERNELS = ("_gram",)  # sparsefit/regression/NAME.c

setup(
    ext_modules=[
        Extension(
            f"sparsefit.{name}",
            [f"sparsefit/{name.replace('.', '/')}.c"],
            depends=sorted(glob(f"sparsefit/{name.replace('.', '/')}_*.h")),
            define_macros=[("Py_LIMITED_API", "0x030b0000")],
            py_limited_api=True,
            optional=True,
        )
        for name in (
            *(f"backends.{loop}" for loop in LOOPS),
            *(f"regression.{kernel}" for kernel in KERNELS),
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
