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
    (store.folder / "loops" / ".x.1-0123abcd.tmp").mkdir(parents=True)
    (store.folder / "cache").mkdir()
    (store.folder / "cache" / ".y.1-0123abcd.tmp.npy").write_text("half")
    (store.folder / "cache" / "kept.npy").write_text("whole")
    store.close()
    RunStore.open(store.folder).close()
    assert not (store.folder / "loops" / ".x.1-0123abcd.tmp").exists()
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


@pytest.mark.parametrize("part", ["../x", "/tmp/x", "loops/../../x"])
def test_no_path_leads_out_of_the_folder(store, part):
    with pytest.raises(ConfigError, match="leads out of"):
        store.path(part)
    with pytest.raises(ConfigError), store.new_folder(store.folder / part):
        pytest.fail("made")


def test_no_link_leads_out_of_the_folder(store, tmp_path):
    decoy = tmp_path / "decoy"
    decoy.mkdir()
    (decoy / "kept").write_text("kept")
    for name in ("loops", "weights"):
        (store.folder / name).symlink_to(decoy)
    (store.folder / ".x.1-0123abcd.tmp").symlink_to(decoy)
    for target in (("loops", "00", "slam"), ("weights",)):
        with pytest.raises(ConfigError, match="leads out of"), store.new_folder(store.folder.joinpath(*target)):
            pytest.fail("made")
    store.close()
    RunStore.open(store.folder).close()
    assert not (store.folder / ".x.1-0123abcd.tmp").is_symlink()
    assert [path.name for path in decoy.iterdir()] == ["kept"]


def test_only_folders_of_runs_are_replaced(store):
    with pytest.raises(ConfigError, match="no folder of a run"), store.new_folder(store.folder / "photos"):
        pytest.fail("made")


def test_files_that_only_look_temporary_are_kept(store):
    for name in (".notes.tmp", ".backup.tmp.npy", "x.1-0123abcd.tmp"):
        (store.folder / name).write_text("kept")
    store.close()
    RunStore.open(store.folder).close()
    assert {".notes.tmp", ".backup.tmp.npy", "x.1-0123abcd.tmp"} <= {path.name for path in store.folder.iterdir()}


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"step": "a", "result": 5}', '{"step": "a", "result": [1, 3]}'])
def test_a_step_that_was_changed_is_refused(store, text):
    store.finish("a", [1, 2])
    marker = store.folder / "steps" / "a.json"
    whole = marker.read_text()
    marker.write_text(whole.replace("2", "3") if text.startswith("{") and "3" in text else text)
    with pytest.raises(DataError, match="delete it"):
        store.result("a")
    marker.write_text(whole)
    assert store.result("a") == [1, 2]
