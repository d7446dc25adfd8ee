"""The compiled loops: one small C module each, of the stable interface, so one wheel a platform.

They are optional: without a C compiler the same algorithms run in Python, slower.
"""

from setuptools import Extension, setup

LOOPS: tuple[str, ...] = ("_variational",)  # sparsefit/backends/NAME.c

setup(
    ext_modules=[
        Extension(
            f"sparsefit.backends.{name}",
            [f"sparsefit/backends/{name}.c"],
            define_macros=[("Py_LIMITED_API", "0x030b0000")],
            py_limited_api=True,
            optional=True,
        )
        for name in LOOPS
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if LOOPS else {},
)
