"""What newcomers type: every mistake is answered by one sentence that says what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from prgbd.__main__ import main
from tests.robustness.fuzzing import judged_exit

SLAM = ("slam=orb_gtsam", "task=slam")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([*SLAM, "data.root=clip.mp4"], "add data=video"),
        ([*SLAM, "data.root=pictures"], "add data=images"),
        ([*SLAM, "data=images", "data.root=clip.mp4"], "for a video take data=video"),
        ([*SLAM, "data=images", "data.root=pictures/0.png"], "give the folder it lies in"),
        ([*SLAM, "data=video", "data.root=my", "clips/a.mp4"], 'needs quotes: "data.root=my clips/a.mp4"'),
        ([*SLAM, "data=video", "data.root=~/no such.mp4"], "There is no video file"),
        ([*SLAM, "data=video", "data.root=a(b)=c.mp4"], "There is no video file a(b)=c.mp4"),
        ([*SLAM, "data=clip.mp4"], "write data=video data.root=clip.mp4"),
        ([*SLAM, "data=pictures"], "write data=images data.root=pictures"),
        ([*SLAM, "video=clip.mp4"], "write data=video data.root=FILE"),
        (["clip.mp4"], "write data=video data.root=clip.mp4"),
        (["slam", "orb_gtsam"], "write slam=orb_gtsam."),
        (["slam", "=", "orb_gtsam"], "without spaces around ="),
        ([*SLAM, "data.frames = 3"], "without spaces around ="),
        (["slam=", "orb_gtsam"], "write slam=orb_gtsam without a space"),
        (["--slam", "orb_gtsam"], "no dashes: slam=orb_gtsam."),
        (["-slam=orb_gtsam"], "no dashes: slam=orb_gtsam."),
        (["slam=ORB_GTSAM"], "did you mean 'orb_gtsam'"),
        (["Slam=orb_gtsam"], "did you mean 'slam'"),
        (["slam=orb_gtsam,"], "leave out the ',' at its end"),
        ([*SLAM, "data.sequences=[00"], "a list needs both brackets"),
        (["slam=orb_gtsam task=slam"], "a word of its own"),
        (["“slam=orb_gtsam”"], "curly quotes"),
        ([*SLAM, "data.scene=”street”"], "curly quotes"),
        (["slam={a:1}"], "takes one choice"),
        ([*SLAM, "~nope"], "There is no option 'nope'"),
        ([*SLAM, "data.frames=${nope}"], "refers to ${nope}, which is no option"),
        ([*SLAM, "++foo=3"], "There is no option 'foo'"),
        ([*SLAM, "+foo.bar=3"], "There is no option 'foo.bar'"),
        ([*SLAM, "foo.bar=3"], "There is no option 'foo.bar'"),
        ([*SLAM, "data.frames=" + "1" * 5000], "thousands of digits"),
        ([*SLAM, "data.frames=1e400"], "data.frames is inf"),
        ([*SLAM, "data=images", "data.root=" + "a" * 5000], "name too long"),
        ([*SLAM, "slam.load_map=" + "a" * 5000], "name too long"),
        ([*SLAM, "+loss.edge=0.1", "task=self_improve", "depth=monodepth2"], "no loss plug-in 'edge'"),
    ],
    ids=lambda value: " ".join(value)[:60] if isinstance(value, list) else None,
)
def test_mistakes(arguments: list[str], words: str, tmp_path: Path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    Path("clip.mp4").write_bytes(b"no film")
    Path("pictures").mkdir()
    Path("pictures/0.png").write_bytes(b"no picture")
    code = main(arguments)
    said = capfd.readouterr().err
    judged_exit("what newcomers type", code, said)
    assert code == 2
    assert words.lower() in said.lower(), said


def test_the_version_is_prgbds(capsys) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("prgbd ")
