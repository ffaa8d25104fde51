import json

import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.io.files import atomic_path, read_json, write_json


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "deep" / "a.txt"
    with atomic_path(path) as temporary:
        temporary.write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_path(path) as temporary:  # noqa: PT012
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]


def test_the_temporary_file_keeps_folder_and_suffix(tmp_path):
    with atomic_path(tmp_path / "x.npz") as temporary:
        assert temporary.parent == tmp_path
        np.savez(temporary, a=1)  # would add a suffix to a name without one
    assert np.load(tmp_path / "x.npz")["a"] == 1


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    with pytest.raises(RuntimeError), atomic_path(tmp_path / "d") as temporary:  # noqa: PT012
        temporary.mkdir()
        (temporary / "f").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with atomic_path(tmp_path / "d") as temporary:
        temporary.mkdir()
        (temporary / "f").write_text("x")
    assert (tmp_path / "d" / "f").read_text() == "x"


def test_json_takes_numpy_and_writes_null_for_nan(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"x": np.float32(0.5), "n": np.int64(3), "b": np.bool_(True), "v": np.array([1.0, np.nan]),
                      "inf": float("inf"), "p": tmp_path, 1: (1, None)})  # fmt: skip
    assert "NaN" not in path.read_text()
    assert read_json(path) == {
        "x": 0.5, "n": 3, "b": True, "v": [1.0, None], "inf": None, "p": str(tmp_path), "1": [1, None],
    }  # fmt: skip
    json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(name))


def test_an_object_without_a_plain_form_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"x": object()})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [None, '{"half": ', b"\xff\xfe\x00"])
def test_an_unreadable_json_file_is_a_data_error_that_names_it(tmp_path, content):
    path = tmp_path / "a.json"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DataError, match="a\\.json"):
        read_json(path)
