import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.io.files import read_json, write_json
from prgbd.report.__main__ import main
from prgbd.report.page import LARGEST, render, write_report
from prgbd.report.reading import open_run, read_losses
from prgbd.report.tables import loops_table
from tests.report.fake_run import make_run

VOID = {"meta", "img", "br", "hr", "input", "link"}


class Page(HTMLParser):
    """Collects what the tests ask for and fails on tags that do not nest."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.links, self.headings, self.words, self.ids, self.counts = [], [], [], [], [], {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.counts[tag] = self.counts.get(tag, 0) + 1
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "action", "data", "poster", "srcset"):
                self.links.append(value)
            if name == "id":
                self.ids.append(value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("h1", "h2", "h3"):
            self.headings.append(data)
        if not {"style", "script"} & set(self.open):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def html(run_folder):
    return render(open_run(run_folder))


def test_the_page_has_every_section_in_order(html):
    page = Page(html)
    assert page.headings == [
        "Self-improving SLAM and depth", "Loops", "Trajectories and tracking", "street-a", "Depth", "Depth by range",
        "Training",
        "All figures", "Set-up and files",
    ]  # fmt: skip
    assert "Over 2 loops the pose error fell from" in page.text
    assert "147/150" in page.text
    assert page.counts["svg"] == 8 + 3 + 17 + 5  # figures by loop, sequence, depth by range, loss terms
    assert page.counts["canvas"] == 1
    assert page.counts["img"] >= 3 * 6
    assert "depth_transfer: 1.0" in page.text
    assert "pRGBD-Refined 1" in page.text  # two loops of one name are told apart


def test_the_page_needs_nothing_from_outside(html):
    page = Page(html)
    outside = [link for link in page.links if not link.startswith(("data:", "#")) and ":" in link]
    assert outside == []
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 2  # the program and the one sequence's data
    assert not any(word in text for text in scripts for word in ("fetch(", "XMLHttpRequest", "import(", "http"))
    assert page.counts.get("link", 0) == page.counts.get("iframe", 0) == 0
    style = html[html.index("<style>") : html.index("</style>")]
    assert "@import" not in style
    assert "url(" not in style
    # The name spaces of SVG are names, not addresses that a browser opens.
    assert set(re.findall(r'https?://[^"\s<]+', html)) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_references_inside_the_page_resolve_and_ids_are_unique(html):
    page = Page(html)
    assert len(page.ids) == len(set(page.ids))
    wanted = {link[1:] for link in page.links if link.startswith("#")} | set(re.findall(r"url\(#([^)]+)\)", html))
    assert wanted
    assert wanted <= set(page.ids)


def test_file_links_lead_to_files(html, run_folder):
    links = [link for link in Page(html).links if not link.startswith(("data:", "#"))]
    assert "loops/00/slam/street-a/map.ply" in links
    assert all((run_folder / link).is_file() for link in links)


def test_writing_is_repeatable(run_folder):
    path = write_report(run_folder)
    assert path == run_folder / "report.html"
    first = path.read_bytes()
    assert len(first) < LARGEST
    assert write_report(run_folder).read_bytes() == first
    path.unlink()


def test_a_slam_run_without_depth_or_truth(tmp_path):
    run = make_run(tmp_path, pose_errors=(2.0,), depth_errors=None, truth=False, task="slam")
    page = Page(write_report(run).read_text())
    assert page.headings == [
        "SLAM",
        "Loops",
        "Trajectories and tracking",
        "street-a",
        "All figures",
        "Set-up and files",
    ]
    assert "There is no ground truth" in page.text
    assert "map units" in page.text


def test_several_sequences_and_a_depth_without_truth(tmp_path):
    run = make_run(tmp_path, sequences=("street-a", "street-b"), truth=False)
    page = Page(write_report(run).read_text())
    assert {"street-a", "street-b", "Depth"} <= set(page.headings)
    assert "there is no truth" in page.text
    assert "relative error" not in page.text


def test_missing_and_broken_parts_leave_the_rest(tmp_path):
    run = make_run(tmp_path)
    broken = run / "loops/00/slam/street-a/result.npz"
    broken.write_bytes(broken.read_bytes()[:100])
    (run / "loops/00/training/losses.csv").write_text("step,total\n0,abc\n")
    (run / "loops/01/depth/samples.npz").write_bytes(b"PK")
    (run / "truth/street-a.tum").write_text("nonsense\n")
    (run / "config.yaml").unlink()
    page = Page(write_report(run).read_text())
    assert "Not shown, because it could not be read" in page.text
    for name in ("result.npz", "losses.csv", "samples.npz", "street-a.tum"):
        assert name in page.text
    assert "Trajectories and tracking" in page.headings
    assert "Depth" in page.headings
    shutil.rmtree(run / "loops")
    page = Page(write_report(run).read_text())
    assert "Loops" in page.headings
    assert "Trajectories and tracking" not in page.headings


def test_names_from_the_data_cannot_inject(tmp_path):
    run = make_run(tmp_path, pose_errors=(1.0,), depth_errors=(0.3,), data='<script>alert("x")</script>')
    summary = read_json(run / "summary.json")
    pose = summary["loops"][0]["pose"].pop("street-a")
    summary["loops"][0]["pose"]["<img src=x>"] = pose
    summary["loops"][0]["name"] = '"><script>x</script></style><b>'
    write_json(run / "summary.json", summary)
    (run / "config.yaml").write_text("<script>x</script>")
    (run / "<b onclick=x>").write_text("a file")
    page = Page(write_report(run).read_text())
    assert page.counts["script"] == 1 + page.counts.get("canvas", 0)
    assert "x" not in page.links
    assert "b" in page.counts  # the page's own; none of the data's has an attribute
    assert "<b onclick" not in (run / "report.html").read_text()


def test_a_lost_run_is_reported(tmp_path):
    run = make_run(tmp_path, pose_errors=(1.0,), depth_errors=None, lost=range(2, 150), task="slam")
    page = Page(write_report(run).read_text())
    assert "SLAM found a pose for 2 of 150 frames" in page.text
    assert "Only 2 of the poses" in page.text
    assert "Too few poses to draw: pRGBD-Initial" in page.text


def test_large_pictures_are_made_smaller_until_the_page_is_small(tmp_path, monkeypatch):
    run = make_run(tmp_path)
    rng = np.random.default_rng(0)
    for k in range(2):
        path = run / f"loops/{k:02d}/depth/samples.npz"
        np.savez(
            path,
            images=rng.integers(0, 256, (4, 400, 600, 3), np.uint8),
            depth=rng.uniform(1, 50, (4, 400, 600)).astype(np.float32),
            frame_index=np.arange(4),
            sequence=np.array(["a"] * 4),
        )
    monkeypatch.setattr("prgbd.report.page.LARGEST", 700_000)
    assert write_report(run).stat().st_size < 700_000


def test_chosen_columns_are_written_as_tables(run_folder, tmp_path, capsys):
    run = shutil.copytree(run_folder, tmp_path / "run")
    assert main([str(run), "--columns", "abs_rel,rmse"]) == 0
    assert "tables.tex" in capsys.readouterr().out
    assert "| loop | Abs Rel | RMSE (m) |" in (run / "tables.md").read_text()
    assert r"\begin{tabular}{lrr}" in (run / "tables.tex").read_text()
    assert main([str(run), "--columns", "speed"]) == 2
    assert "There is no column 'speed'" in capsys.readouterr().err


def test_a_folder_that_is_no_run_is_named(tmp_path, capsys):
    with pytest.raises(DataError, match=r"summary\.json"):
        write_report(tmp_path)
    assert main([str(tmp_path)]) == 2
    assert "no run below" in capsys.readouterr().err
    (tmp_path / "summary.json").write_text("[1, 2]")
    assert main([str(tmp_path)]) == 2
    assert "not a run summary" in capsys.readouterr().err


def test_the_command_rebuilds_report_and_metrics(tmp_path, capsys):
    run = make_run(tmp_path / "r")
    assert main([str(run)]) == 0
    assert (run / "report.html").is_file()
    assert (run / "metrics.csv").is_file()
    out = capsys.readouterr().out
    assert "pRGBD-Initial" in out
    assert "report.html" in out


def test_a_half_written_last_line_of_losses_is_dropped(tmp_path):
    (tmp_path / "l.csv").write_text("step,total,photometric\n0,1.5,\n1,1.2")
    losses = read_losses(tmp_path / "l.csv")
    np.testing.assert_array_equal(losses["total"], [1.5])
    assert np.isnan(losses["photometric"]).all()
    (tmp_path / "l.csv").write_text("")
    assert read_losses(tmp_path / "l.csv") == {}


def test_baselines_and_test_sequences_stand_apart(tmp_path):
    run = make_run(tmp_path / "r", sequences=("street-a", "street-b"), depth_errors=None)
    shutil.copytree(run / "loops/00/slam", run / "baselines/mono/slam")
    summary = read_json(run / "summary.json")
    first = summary["loops"][0]["pose"]
    summary["test_sequences"] = ["street-b"]
    summary["baselines"] = [{"name": "RGB SLAM", "folder": "baselines/mono", "pose": {"street-b": first["street-b"]}}]
    write_json(run / "summary.json", summary)
    table = loops_table(summary)
    rows = table.rows
    assert [row["loop"] for row in rows] == ["RGB SLAM", "0 pRGBD-Initial", "1 pRGBD-Refined"]
    assert rows[0]["ATE RMSE (m)"] is None
    assert rows[0]["ATE, test (m)"] == rows[1]["ATE, test (m)"] == first["street-b"]["ate_rmse"]
    assert rows[1]["ATE RMSE (m)"] == first["street-a"]["ate_rmse"]
    assert "1 training and 1 test sequences" in table.note
    page = Page(write_report(run).read_text())
    assert any("RGB SLAM" in words for words in page.words)
    assert page.counts["canvas"] == 2


def test_depth_alone_without_truth_has_a_page(tmp_path):
    run = make_run(tmp_path / "run", pose_errors=(1.0,), truth=False, task="depth")
    summary = read_json(run / "summary.json")
    summary["loops"][0] |= {"pose": {}, "depth": None}
    write_json(run / "summary.json", summary | {"stop": None})
    text = Page(write_report(run).read_text()).text
    assert "there is no ground truth" in text
    assert "pRGBD-Initial" in text  # the depth maps are shown
