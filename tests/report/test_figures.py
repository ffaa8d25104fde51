import base64
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prgbd.core.types import MapPoints
from prgbd.report import curves, drawing, figures
from prgbd.report.drawing import INK, Drawing
from prgbd.report.figures import Estimate, Path3D
from prgbd.report.interactive import view
from prgbd.report.pictures import UNKNOWN, depth_picture, depth_rows, error_picture, relative_error, thicken, to_jpeg
from prgbd.report.reading import DepthSamples
from tests.report.fake_run import slam_result, true_poses


def test_lines_break_where_frames_are_missing_and_keep_their_ends():
    frames = np.array([0, 1, 2, 10, 11, 20])
    x, y = drawing.broken(frames, frames, frames * 2.0)
    np.testing.assert_array_equal(x, [0, 1, 2, np.nan, 10, 11, np.nan, 20])
    np.testing.assert_array_equal(y, x * 2)
    assert len(drawing.broken(np.zeros(0, int), np.zeros((0, 3)))[0]) == 0
    many = np.concatenate([np.arange(5000), np.arange(6000, 9000)])
    (thin,) = drawing.broken(many, many)
    assert len(thin) < 2100
    assert {0.0, 4999.0, 6000.0, 8999.0} <= set(thin[~np.isnan(thin)])
    gap = np.flatnonzero(np.isnan(thin))
    assert list(thin[gap - 1]) == [4999]
    assert list(thin[gap + 1]) == [6000]


@pytest.mark.parametrize(
    ("world_from_camera_convention", "axes"),
    [(np.eye(3), (0, 2)), (Rotation.from_euler("x", -90, degrees=True).as_matrix(), (0, 1))],
)
def test_the_view_is_from_above_whatever_axis_is_up(world_from_camera_convention, axes):
    wTc = true_poses()
    wTc[:, :3, :3] = world_from_camera_convention @ wTc[:, :3, :3]
    right, up = figures.horizontal_axes(wTc)
    assert (right, up) == axes
    # Seen from above, right x up points against the camera's down axis: the view is not mirrored.
    toward_viewer = np.cross(np.eye(3)[right], np.eye(3)[up])
    assert toward_viewer @ wTc[:, :3, 1].mean(axis=0) < 0


def test_every_figure_renders_and_twice_the_same():
    xyz = true_poses()[:, :3, 3]
    frames = np.arange(len(xyz))
    result = slam_result(true_poses(), frames / 10, 1.0, lost=(40, 41))
    losses = {"step": frames, "total": np.exp(-frames / 50), "photometric": np.full(150, np.nan)}
    made = [
        lambda: figures.trajectory_figure(
            [Path3D("truth", frames, xyz), Path3D("a", frames[5:], xyz[5:], "#e0783a")], (0, 2), xyz
        ),
        lambda: figures.trajectory_figure([Path3D("still", frames[:3], xyz[:3] * 0)], (0, 2)),
        lambda: figures.error_figure([("a", "#e0783a", frames, np.ones(150))]),
        lambda: figures.timeline_figure([Estimate("a", "#e0783a", result)]),
        lambda: figures.timeline_figure([Estimate("a", "#e0783a", replace(result, states=[], inliers=frames[:0]))]),
        lambda: figures.loss_figure([("a", losses), ("b", losses)], "total"),
        lambda: figures.loss_figure([("a", {"total": np.ones(1)})], "total"),
        lambda: curves.metric_figure("m", {"a": [1.0, None, 0.5], "b": [None, None, None]}),
    ]  # fmt: skip
    for make in made:
        svg = drawing.to_bytes(make(), "svg")
        assert svg == drawing.to_bytes(make(), "svg")
        ET.fromstring(svg)
    assert drawing.to_bytes(made[0](), "png")[:4] == b"\x89PNG"
    assert figures.loss_terms([("a", losses)]) == ["total"]


def test_inline_svg_follows_the_theme_and_keeps_its_references_apart():
    text = Drawing('a "label"', curves.metric_figure("m<", {"a": [1.0, 2.0]})).svg
    other = Drawing("b", curves.metric_figure("m<", {"a": [1.0, 2.0]})).svg
    root = ET.fromstring(text)
    assert root.attrib["aria-label"] == 'a "label"'
    assert "width" not in root.attrib
    assert "viewBox" in root.attrib
    assert "var(--ink)" in text
    assert drawing.INK not in text
    assert "var(--grid)" in text
    ids = {e.attrib["id"] for e in root.iter() if "id" in e.attrib}
    assert ids
    assert not any(f'id="{i}"' in other for i in ids)
    references = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    assert references
    assert references <= ids


def test_loop_colours_differ():
    for count in (1, 2, 5, 8):
        assert len(set(drawing.loop_colours(count))) == count


def samples(depth, truth=None, keys=(("s", 0), ("s", 7))):
    images = np.zeros((len(keys), 8, 12, 3), np.uint8)
    full = np.stack([np.full((8, 12), depth, np.float32)] * len(keys))
    return DepthSamples(images, full, None if truth is None else np.full_like(full, truth), list(keys))


def test_depth_rows_share_one_scale_and_scale_predictions_to_the_truth():
    before, after = samples(2, 10), samples(5, 10)
    before.depth[:, 0] = 3
    rows = depth_rows([("before", before), ("after", after)])
    assert [(r.sequence, r.frame) for r in rows] == [("s", 0), ("s", 7)]
    row = rows[0]
    assert [p.label for p in row.predictions] == ["before", "after"]
    assert row.predictions[1].abs_rel == pytest.approx(0)
    assert row.predictions[0].abs_rel == pytest.approx(0.5 / 8)
    np.testing.assert_array_equal(row.predictions[1].picture, row.truth)
    assert (row.predictions[0].picture[1:] == row.truth[1:]).all()
    assert (row.predictions[0].picture[0] != row.truth[0]).any()


def test_colours_and_scale_follow_the_refined_network():
    before, after = samples(2, 10), samples(5, 10)
    before.depth[:, :4] = 200
    after.depth[:, :4] = 4
    (row, _) = depth_rows([("before", before), ("after", after)])
    assert (row.near, row.far) == (pytest.approx(8, rel=0.15), pytest.approx(10, rel=0.15))
    alone, _ = depth_rows([("after", after)])
    np.testing.assert_array_equal(alone.predictions[0].picture, row.predictions[1].picture)
    without = [("before", samples(2)), ("after", samples(5))]
    assert depth_rows(without)[0].near == pytest.approx(5)  # in the units of the refined network


def test_depth_rows_without_truth_or_common_frames():
    rows = depth_rows([("a", samples(2)), ("b", samples(5))])
    assert rows[0].truth is None
    np.testing.assert_array_equal(rows[0].predictions[0].picture, rows[0].predictions[1].picture)
    assert depth_rows([("a", samples(2)), ("b", samples(2, keys=[("t", 0)]))]) == []
    assert depth_rows([]) == []
    assert len(depth_rows([("a", samples(2, keys=[("s", i) for i in range(9)]))], most=4)) == 4


def test_unknown_is_grey_near_is_bright_and_errors_grow_brighter():
    depth = np.array([[0, 1, 5, 60, np.nan]], np.float32)
    picture = depth_picture(depth, 1, 60)
    assert (picture[0, [0, 4]] == UNKNOWN).all()
    brightness = picture[0, 1:4].sum(axis=1)
    assert brightness[0] > brightness[1] > brightness[2]
    error = relative_error(np.array([[1, 1.3, 2, 4]], np.float32), np.array([[1, 1, 1, 0]], np.float32))
    np.testing.assert_allclose(error, [[0, 0.3, 1, np.nan]], rtol=1e-5)
    picture = error_picture(error).astype(int)
    assert (picture[0, 3] == UNKNOWN).all()
    assert picture[0, 0].sum() < picture[0, 1].sum() < picture[0, 2].sum()


def test_sparse_points_are_thickened_and_dense_maps_are_not():
    sparse = np.zeros((20, 20), np.float32)
    sparse[10, 10] = 4
    assert np.count_nonzero(thicken(sparse)) == 25
    dense = np.ones((20, 20), np.float32)
    np.testing.assert_array_equal(thicken(dense), dense)


def test_jpeg_is_rgb_and_no_wider_than_asked():
    import cv2

    picture = np.zeros((30, 90, 3), np.uint8)
    picture[..., 0] = 250
    back = cv2.imdecode(np.frombuffer(to_jpeg(picture, 45), np.uint8), cv2.IMREAD_COLOR)
    assert back.shape == (15, 45, 3)
    assert back[..., 2].mean() > 200 > 60 > back[..., 0].mean()


@pytest.mark.parametrize(("reach", "kept"), [(1.0, 4), (0.1, 4), (0.001, 0)])
def test_a_camera_that_turns_on_the_spot_keeps_its_map(reach, kept):
    points = np.array([[1.0, 0, 1], [0, 0, 1.2], [-1, 0, 1.1], [0.5, 0, 1], [0, 0, 900], [np.nan, 0, 0]])
    mapped = MapPoints(points, np.zeros((6, 3), np.uint8))
    path = Path3D("loop", np.arange(2), reach * np.array([[0.0, 0, 0], [1, 0, 0]]), INK, mapped)
    scene = view([path], (0, 2), "m", Drawing("map", None)).scene
    found = [np.frombuffer(base64.b64decode(cloud["xyz"]), "<i2") for cloud in scene["clouds"]]
    assert sum(len(numbers) for numbers in found) == 3 * kept


def test_the_view_from_above_fits_the_map():
    rng = np.random.default_rng(0)
    line = np.stack([np.zeros(50), np.zeros(50), np.linspace(0, 10, 50)], axis=1)
    points = rng.uniform((-30, -2, -5), (10, 2, 15), (5000, 3))
    points[:20] = 400  # strays do not shrink the rest to a speck
    path = Path3D("loop", np.arange(50), line, "#e0783a", MapPoints(points, np.zeros((5000, 3), np.uint8)))
    (ax,) = figures.trajectory_figure([path], (0, 2), points).axes
    scene = view([path], (0, 2), "m", Drawing("map", None)).scene
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert left < -28
    assert 9 < right < 60
    assert bottom < -4
    assert 14 < top < 60
    assert 38 < scene["size"][0] < 60
    middle = np.array(next(point for point in scene["paths"][0]["xyz"]))
    assert middle[0] == pytest.approx(10, abs=1)  # the box reaches from -30 to 10, and the path runs along 0
