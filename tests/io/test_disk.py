"""Files that cannot be written, each in one sentence."""

import errno
import os

import numpy as np
import pytest
import torch

from prgbd.core.errors import DiskError
from prgbd.io.disk import allocated, require_writable, writing
from prgbd.io.files import atomic_path, write_json


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES])
def test_what_the_disk_says_is_one_sentence_and_nothing_is_left(tmp_path, code):
    path = tmp_path / "new" / "a.json"
    with pytest.raises(DiskError, match=r"a\.json cannot be written"), atomic_path(path) as temporary:  # noqa: PT012
        temporary.write_text("half")
        raise OSError(code, os.strerror(code))
    assert list(path.parent.iterdir()) == []


def test_another_file_s_error_is_not_taken_for_this_one(tmp_path):
    with pytest.raises(PermissionError), atomic_path(tmp_path / "a.json"):
        raise PermissionError(errno.EACCES, "no", "/elsewhere/image.png")


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DiskError, match="cannot be written"):
        write_json(tmp_path / "file" / "a.json", {})
    with pytest.raises(DiskError, match="too long"):
        write_json(tmp_path / ("x" * 300) / "a.json", {})


def test_room_for_an_array_is_taken_at_once(tmp_path):
    array = allocated(tmp_path / "a.npy", (100, 1000), np.float32)
    assert os.stat(tmp_path / "a.npy").st_blocks * 512 >= array.nbytes
    array[:] = 2
    array.flush()
    assert (np.load(tmp_path / "a.npy") == 2).all()


def test_no_room_for_an_array_names_file_and_size(tmp_path, monkeypatch):
    def full(descriptor, size):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("prgbd.io.disk._allocate", full)
    with pytest.raises(DiskError, match=r"a\.npy needs 40\.0 MB"):
        allocated(tmp_path / "a.npy", (10, 1000, 1000), np.float32)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="Linux alone has a disk that is always full")
def test_writers_of_all_kinds_on_a_full_disk():
    with pytest.raises(DiskError), writing("/dev/full"):
        torch.save({"x": torch.zeros(100_000)}, "/dev/full")
    with pytest.raises(DiskError), writing("/dev/full"), open("/dev/full", "wb") as file:
        np.savez_compressed(file, x=np.random.default_rng(0).random(100_000))


def test_a_file_that_cannot_be_written_is_found_before_the_work(tmp_path):
    require_writable(tmp_path / "new" / "map.npz", "slam.save_map")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "map.npz", tmp_path / ("x" * 300)):
        with pytest.raises(DiskError, match=r"slam\.save_map"):
            require_writable(path, "slam.save_map")
