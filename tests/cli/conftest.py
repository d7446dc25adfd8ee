"""Every test of a verb works in a folder of its own; what a verb writes is all that is there."""

import pytest


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
