"""Estimators that fit a processor, a flight to try them on, and a C compiler where there is one."""

import shutil
import subprocess

import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.export import Plan, answers, package
from sparsefit.export.package import asked_at
from sparsefit.export.sheet import sheet

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror")
SANITIZED = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")


def estimator(backend="best-scale", refine="variable-projection", count=30, **more):
    """Uniform in wavenumber between 2 m and 8 m; more: derivative, readout, every, settings."""
    library = sf.Library(
        grid=sf.LengthScaleGrid(2.0, 8.0, count=count, spacing="wavenumber"),
        every=more.pop("every", 1),
    )
    readout = more.pop("readout", {})
    return sf.Estimator(
        derivative=more.pop("derivative", sf.Derivative("savgol", window=11, order=4)),
        library=library,
        backend=backends.get(backend, **more),
        readout=sf.Readout(refine=refine, correction="none", **readout),
    )


def fly(seed=7, noise=0.1, rate=50.0, duration=8.0):
    """A flight with steps of whole microseconds."""
    return sf.simulate_flight(
        sf.CellularFlow(mean_velocity=15.43, length_scale=4.21),
        VEHICLE,
        duration=duration,
        sample_rate=rate,
        seed=seed,
        velocity_noise=noise,
        position_noise=0.1 * noise,
    )


def written(plan, flight, folder):
    """The export of a plan in a folder."""
    tested = list(answers(plan, flight, asked_at(flight)))
    for path, content in package(plan, flight, tested, sheet(plan, "a.json", None)).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return folder


def compiled(folder, *sources, flags=STRICT, compiler="cc", output="program"):
    """A program of these sources of an export, which must compile without a word."""
    command = [compiler, *flags, "-I.", *sources, "-lm", "-o", output]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    assert not done.stderr
    return folder / output


def ran(program, *arguments):
    """What a program says, its exit code first."""
    done = subprocess.run(
        [program, *map(str, arguments)],
        cwd=program.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def plan_of(real="double", **settings):
    """A plan of `estimator`."""
    return Plan(estimator(**settings), real)
