"""A verb in this process: its exit code, stdout and stderr."""

from pathlib import Path

from sparsefit.cli import main


def run(capsys, *argv):
    """Exit code, stdout and stderr of a verb; argparse leaves by SystemExit."""
    capsys.readouterr()
    try:
        code = main([str(word) for word in argv])
    except SystemExit as left:
        code = left.code
    return (code, *capsys.readouterr())


def refused(capsys, *argv):
    """The one line on stderr of a verb that exits 2 and writes nothing."""
    before = sorted(map(str, Path().rglob("*")))
    code, out, err = run(capsys, *argv)
    assert (code, out) == (2, "")
    assert err.startswith("sparsefit: error: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert sorted(map(str, Path().rglob("*"))) == before
    return err
