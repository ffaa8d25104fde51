import os

import numpy as np
import pytest

from prgbd.core.errors import ConfigError, DataError
from prgbd.loop.store import RunStore, newest_unfinished


@pytest.fixture
def store(tmp_path):
    made = RunStore.create(tmp_path / "run", {"seed": 1})
    yield made
    made.close()


def test_a_step_is_done_once_and_its_result_is_remembered(store):
    calls = []

    def work():
        calls.append(1)
        return {"value": np.float32(2.5), "nothing": float("nan")}

    first = store.step("loops/00/slam/a b", work)
    assert first == store.step("loops/00/slam/a b", work) == {"value": 2.5, "nothing": None}
    assert len(calls) == 1
    assert not store.is_done("loops/00/slam")


def test_a_step_that_fails_is_not_done(store):
    with pytest.raises(ZeroDivisionError):
        store.step("x", lambda: 1 / 0)
    assert not store.is_done("x")


def test_an_opened_run_knows_its_config_and_steps(store):
    store.finish("a", [1, 2])
    store.close()
    again = RunStore.open(store.folder)
    assert again.config == {"seed": 1}
    assert again.result("a") == [1, 2]
    assert not again.is_finished
    again.close()


def test_one_process_at_a_time(store):
    with pytest.raises(ConfigError, match="Another process"):
        RunStore.open(store.folder)
    store.close()
    RunStore.open(store.folder).close()


def test_a_folder_with_a_run_is_refused(store):
    with pytest.raises(ConfigError, match="holds a run already"):
        RunStore.create(store.folder, {})


def test_a_folder_appears_whole_or_not_at_all(store):
    target = store.loop(0, "weights")

    def fail():
        with store.new_folder(target) as folder:
            (folder / "half").write_text("x")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert not target.exists()
    assert [p.name for p in target.parent.iterdir()] == []
    for text in ("old", "new"):
        with store.new_folder(target) as folder:
            (folder / text).write_text(text)
    assert [p.name for p in target.iterdir()] == ["new"]


def test_leftovers_of_a_killed_process_are_swept_out(store):
    (store.folder / "loops" / ".x.1-2.tmp").mkdir(parents=True)
    (store.folder / "cache").mkdir()
    (store.folder / "cache" / ".y.1-2.tmp.npy").write_text("half")
    (store.folder / "cache" / "kept.npy").write_text("whole")
    store.close()
    RunStore.open(store.folder).close()
    assert not (store.folder / "loops" / ".x.1-2.tmp").exists()
    assert [p.name for p in (store.folder / "cache").iterdir()] == ["kept.npy"]


def test_no_run_and_broken_run(tmp_path):
    with pytest.raises(ConfigError, match="no run in"):
        RunStore.open(tmp_path)
    (tmp_path / "config.yaml").write_text("a: [1")
    with pytest.raises(DataError, match=r"config\.yaml"):
        RunStore.open(tmp_path)


def test_newest_unfinished(tmp_path):
    with pytest.raises(ConfigError, match="no unfinished run"):
        newest_unfinished(tmp_path)
    for place, (name, finished) in enumerate((("a", False), ("b/0", False), ("c", True))):
        store = RunStore.create(tmp_path / name, {})
        os.utime(store.folder / "config.yaml", (place, place))
        if finished:
            store.finish("done")
        store.close()
    assert newest_unfinished(tmp_path) == tmp_path / "b" / "0"
