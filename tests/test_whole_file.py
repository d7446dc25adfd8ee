import errno
import os
import stat

import pytest

from sparsefit import whole_file as module
from sparsefit.errors import InputError
from sparsefit.whole_file import read_whole, whole_file, write_whole


def test_text_and_bytes_replace_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "τ")
    assert path.read_bytes() == "τ".encode()
    write_whole(path, b"\r\n")
    assert path.read_bytes() == b"\r\n"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "old")

    def half_written():
        with whole_file(path) as file:
            file.write(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        half_written()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_full_disk_is_told_with_file_and_folder(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(module.os, "fsync", full)
    with pytest.raises(InputError) as error:
        write_whole(tmp_path / "a.txt", "text")
    assert str(error.value) == (
        f"cannot write {tmp_path}/a.txt: No space left on device; make room, or choose another "
        "folder"
    )
    assert os.listdir(tmp_path) == []


def test_no_folder_no_file_and_a_folder_in_the_way(tmp_path):
    (tmp_path / "taken").mkdir()
    for name, cause in (
        ("absent/a", "No such file or directory; check the path"),
        ("taken", "Is a directory; choose another name"),
        ("a" * 300, "File name too long; choose a shorter name"),
    ):
        with pytest.raises(InputError, match=rf"^cannot write .*: {cause}$"):
            write_whole(tmp_path / name, "text")
    assert os.listdir(tmp_path) == ["taken"]


def test_links_are_replaced_and_never_followed(tmp_path, monkeypatch):
    victim, target = tmp_path / "victim", tmp_path / "cases"
    victim.write_text("precious")
    target.symlink_to(victim)
    write_whole(target, "rows")
    assert (victim.read_text(), target.read_text()) == ("precious", "rows")
    assert not target.is_symlink()

    monkeypatch.setattr(module.secrets, "token_hex", lambda _: "foreseen")
    (tmp_path / ".cases.foreseen.partial").symlink_to(victim)
    with pytest.raises(InputError, match="File exists"):
        write_whole(target, "other rows")
    assert (victim.read_text(), target.read_text()) == ("precious", "rows")


def test_permissions_are_those_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("")
    write_whole(tmp_path / "a", "")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "a")}
    assert len(modes) == 1


def test_long_names_can_be_written(tmp_path):
    write_whole(tmp_path / ("ä" * 120), "text")
    assert len(os.listdir(tmp_path)) == 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_what_may_have_no_end_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "long").write_bytes(b"12345")
    (tmp_path / "none").touch()
    assert read_whole(tmp_path / "long", most=5) == b"12345"
    for name, words in (
        ("pipe", "no regular file"),
        ("zero", "no regular file"),
        ("", "a folder"),
        ("long", "too long, .*is it the right file"),
        ("none", "it is empty; give another"),
        ("absent", "No such file"),
        ("a\0b", "null (byte|character)"),
    ):
        with pytest.raises(InputError, match=words):
            read_whole(tmp_path / name, most=4)
