import math
import os

from sparsefit.child import in_child


def test_a_file_of_the_users_folder_stands_before_nothing_of_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "signal.py").write_text("raise SystemExit('not for you')")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    assert in_child(math.sqrt, 4.0, seconds=60.0) == 2.0
    assert in_child(os.getenv, "PYTHONSAFEPATH", seconds=60.0) is None
