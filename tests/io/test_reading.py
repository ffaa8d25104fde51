"""Reading the user's files."""

from __future__ import annotations

import os

import pytest

from prgbd.core.errors import DataError
from prgbd.io.reading import read_text, require_file, visible

TEXT = "# Zeit\n1.5 größe\n"


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32", "cp1252"], ids=lambda encoding: f"from {encoding}"
)
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_text_of_every_origin_reads_the_same(tmp_path, encoding, newline):
    file = tmp_path / "times.txt"
    file.write_bytes(TEXT.replace("\n", newline).encode(encoding))
    assert read_text(file, "times") == TEXT


@pytest.mark.parametrize("data", [b"\x89PNG\r\n\0\0", b"\xff\xfea"], ids=["image", "half a character"])
def test_what_is_no_text_is_refused(tmp_path, data):
    file = tmp_path / "times.txt"
    file.write_bytes(data)
    with pytest.raises(DataError, match=r"times\.txt \(times\) is no text"):
        read_text(file, "times")


def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="pipe or a device"):
        require_file(tmp_path / "pipe", "times")


@pytest.mark.parametrize("name", ["absent", "x" * 300, "a\0b", "file/below"])
def test_a_path_that_cannot_be_opened_is_named(tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="check the path"):
        require_file(tmp_path / name, "times")


def test_hidden_files_are_not_listed(tmp_path):
    for name in ("b.MP4", "a.mp4", "._a.mp4", "note.txt"):
        (tmp_path / name).touch()
    (tmp_path / "folder.mp4").mkdir()
    assert [path.name for path in visible(tmp_path, [".mp4"])] == ["a.mp4", "b.MP4"]
    with pytest.raises(DataError, match="cannot be listed"):
        visible(tmp_path / "absent")
