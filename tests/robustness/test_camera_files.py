"""Camera files of every format, damaged in every way."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from prgbd.plugins.data._camera import camera_from_values, make_camera
from tests.plugins.data.test_camera_files import EUROC, KALIBR, MESSAGE, OWN, ROS
from tests.robustness.fuzzing import examples, judged

ORB_SLAM = '%YAML:1.0\n---\nCamera.type: "MODEL"\nCamera.fx: FX\nCamera.fy: FY\nCamera.cx: 318\nCamera.cy: 242\n'
OPENCV = (
    "%YAML:1.0\n---\nimage_width: 640\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ FX, 0., 318., 0., FY, 242., 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 4\n"
    "   cols: 1\n   dt: d\n   data: LENS\n"
)
XML = (
    '<?xml version="1.0"?>\n<opencv_storage>\n<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols>'
    "<dt>d</dt><data>FX 0. 318. 0. FY 242. 0. 0. 1.</data></camera_matrix>\n</opencv_storage>\n"
)
NUMBERS = st.one_of(st.floats(), st.integers(-(10**6), 10**6), st.floats(100, 1000))
ANYTHING = st.recursive(
    st.one_of(NUMBERS, st.booleans(), st.none(), st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=15), st.dictionaries(st.text(max_size=6), inner, max_size=4)),
    max_leaves=8,
)
KEYS = st.sampled_from(["width", "height", "fx", "fy", "cx", "cy", "distortion", "model", "fov_degrees"])
SOUND = {"fx": 500, "fy": 500, "cx": 320, "cy": 240}


@examples(small=60, large=600)
@given(
    text=st.sampled_from([ROS, KALIBR, EUROC, MESSAGE, OWN, ORB_SLAM, OPENCV, XML]),
    fx=NUMBERS,
    lens=st.lists(st.one_of(NUMBERS, st.floats(-0.5, 0.5)), max_size=15),
    model=st.sampled_from(["radtan", "plumb_bob", "equidistant", "fisheye", "opencv", "KannalaBrandt8", "omni"]),
    damage=st.tuples(st.floats(0, 1), st.integers(0, 4), st.binary(max_size=4)),
)
def test_files(tmp_path_factory, text: str, fx: float, lens: list, model: str, damage: tuple) -> None:
    for word, value in (("FX", fx), ("FY", 500.0), ("LENS", lens), ("MODEL", model)):
        text = text.replace(word, str(value))
    part, left_out, put_in = damage
    data = text.encode()
    at = int(part * len(data))
    file: Path = tmp_path_factory.getbasetemp() / "camera.yaml"
    file.write_bytes(data[:at] + put_in + data[at + left_out :])
    with judged("camera files"):
        make_camera(file, None, 640, 480, file)


@examples(small=60, large=600)
@given(
    changes=st.dictionaries(KEYS, ANYTHING, max_size=2), lens=st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=5)
)
def test_values(changes: dict, lens: list) -> None:
    with judged("camera values"):
        camera_from_values({**SOUND, "distortion": lens, **changes}, "the option data.camera", 640, 480)
