"""What to download of a data set and from where, and what of it lies in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.core.registry import REGISTRY


@dataclass(frozen=True)
class Guide:
    """What belongs to a data set.

    Attributes:
        page: The official page.
        download: What to fetch there.
        layout: How it lies in the folder.
        parts: (pattern relative to a recording, what it gives, whether a recording is of no use without it). A pattern
            with ``{name}`` is relative to the folder of the data set.
        recordings: Pattern of a recording's folder relative to the data set's, with ``{name}``.
        licence: In a few words.
    """

    page: str
    download: tuple[str, ...]
    layout: str
    recordings: str
    parts: tuple[tuple[str, str, bool], ...]
    licence: str


GUIDES = {
    "kitti_odometry": Guide(
        "https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
        (
            "odometry data set (gray, 22 GB) or (color, 65 GB)",
            "odometry data set (calibration files, 1 MB)",
            "odometry ground truth poses (4 MB)",
        ),
        "sequences/00/{image_0, image_1, image_2, image_3, calib.txt, times.txt} and poses/00.txt",
        "sequences/{name}",
        (
            ("image_[02]/*", "images", True),
            ("calib.txt", "calibration", True),
            ("times.txt", "time stamps", True),
            ("image_[13]/*", "right images, for slam.mode=stereo", False),
            ("../../poses/{name}.txt", "true poses (sequences 00 to 10 have them)", False),
        ),
        "CC BY-NC-SA 3.0",
    ),
    "kitti_raw": Guide(
        "https://www.cvlibs.net/datasets/kitti/raw_data.php",
        (
            "of each drive: synced+rectified data",
            "of each day: calibration",
            "for the Eigen split: the split files, as published with Monodepth2 (data.split=FILE)",
        ),
        "2011_09_26/{calib_*.txt, 2011_09_26_drive_0001_sync/{image_02, velodyne_points, oxts}}",
        "*/{name}",
        (
            ("image_0[02]/data/*", "images", True),
            ("../calib_cam_to_cam.txt", "calibration", True),
            ("image_0[02]/timestamps.txt", "time stamps (10 Hz is taken without)", False),
            ("velodyne_points/data/*.bin", "scans, for true depth", False),
            ("../calib_velo_to_cam.txt", "calibration of the velodyne, for true depth", False),
            ("oxts/data/*.txt", "GPS and inertia, for true poses", False),
            ("../calib_imu_to_velo.txt", "calibration of the inertial unit, for true poses", False),
        ),
        "CC BY-NC-SA 3.0",
    ),
    "tum_rgbd": Guide(
        "https://cvg.cit.tum.de/data/datasets/rgbd-dataset/download",
        ("the recordings (tgz), unpacked; the paper uses those of freiburg3",),
        "rgbd_dataset_freiburg3_walking_xyz/{rgb, depth, rgb.txt, depth.txt, groundtruth.txt}",
        "{name}",
        (
            ("rgb/*", "images", True),
            ("rgb.txt", "time stamps", True),
            ("depth/*", "depth of the sensor", False),
            ("groundtruth.txt", "true poses", False),
        ),
        "CC BY 4.0",
    ),
    "euroc": Guide(
        "https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets",
        ("of each sequence, such as MH_01_easy: ASL Dataset Format (zip), unpacked into a folder of its name",),
        "MH_01_easy/mav0/{cam0, cam1, state_groundtruth_estimate0}, each with data.csv",
        "**/{name}/mav0",
        (
            ("cam0/data/*.png", "images", True),
            ("cam0/data.csv", "time stamps", True),
            ("cam0/sensor.yaml", "calibration", True),
            ("cam1/data/*.png", "right images, for slam.mode=stereo", False),
            ("state_groundtruth_estimate0/data.csv", "true poses", False),
        ),
        "terms on the page",
    ),
    "seven_scenes": Guide(
        "https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/",
        ("a scene (zip), and the zips of its sequences unpacked inside",),
        "redkitchen/seq-01/{frame-000000.color.png, frame-000000.depth.png, frame-000000.pose.txt}",
        "",
        (),
        "Microsoft Research, non-commercial",
    ),
}


def prepare(name: str, folder: Path | None) -> int:
    """Print what belongs to a data set and, where a folder is given, what lies in it.

    Args:
        name: Id of the data plug-in.
        folder: Where the data set lies, as in ``data.root=FOLDER``.

    Returns:
        The exit code: 0, or 1 if something that is needed is missing.

    Raises:
        ConfigError: If nothing needs to be downloaded for this plug-in.
    """
    guide = _guide(name)
    for line in _described(name, guide):
        print(line)
    if folder is None:
        print(f"Then: python -m prgbd.tools prepare {name} FOLDER")
        return 0
    return _look(name, guide, folder)


def _guide(name: str) -> Guide:
    if name not in GUIDES:
        REGISTRY.resolve("data", name)  # an unknown name is answered with the nearest
        raise ConfigError(f"data={name} needs nothing to be downloaded; this is for {', '.join(GUIDES)}.")
    return GUIDES[name]


def _described(name: str, guide: Guide) -> Iterator[str]:
    yield f"{name}: from {guide.page} ({guide.licence})"
    for what in guide.download:
        yield f"  download  {what}"
    yield f"  layout    {guide.layout}"


def _look(name: str, guide: Guide, folder: Path) -> int:
    """Print a line per recording in the folder, and what is missing of it."""
    names = REGISTRY.load(REGISTRY.resolve("data", name)).available(root=str(folder))
    broken = 0
    print(f"{folder}: {len(names)} recording{'s' if len(names) != 1 else ''}")
    for recording in names:
        try:
            sequence: Sequence = REGISTRY.make("data", name, root=str(folder), sequence=recording)
            facts = _facts(sequence)
        except PrgbdError as error:
            broken += 1
            print(f"  MEND {recording}: {error}")
        else:
            print(f"  ok   {recording}: {facts}")
        for needed, line in _missing(guide, folder, str(recording)):
            print(f"       {'needs' if needed else 'without'} {line}")
    if broken:
        print(f"{broken} of {len(names)} recordings cannot be used.")
    else:
        print(f"Use it with data={name} data.root={folder}")
    return 1 if broken else 0


def _facts(sequence: Sequence) -> str:
    """One line about a recording, after reading its first, middle and last frame."""
    chosen = sorted({0, len(sequence) // 2, len(sequence) - 1})
    frames = [sequence.frame(index) for index in chosen]
    camera, poses = sequence.camera, sequence.poses
    words = [f"{len(sequence)} frames at {sequence.fps:.1f} Hz, {camera.width}x{camera.height}, f {camera.fx:.0f}"]
    words.append("true poses" if poses is not None else "no true poses")
    if frames[0].depth is not None:
        words.append("sensor depth")
    elif any(sequence.depth(index) is not None for index in range(min(len(sequence), 10))):
        words.append("true depth")
    if sequence.baseline is not None:
        words.append(f"stereo {sequence.baseline:.2f} m")
    return ", ".join(words)


def _missing(guide: Guide, folder: Path, recording: str) -> Iterator[tuple[bool, str]]:
    """What of a recording's parts is not there."""
    if not guide.recordings:
        return
    bases = [base for base in (folder, folder / "dataset") if base.is_dir()]
    homes = [home for base in bases for home in base.glob(guide.recordings.format(name=recording))]
    home = homes[0] if homes else folder  # a single recording may be the folder itself
    for pattern, what, needed in guide.parts:
        pattern, place = pattern.format(name=recording), home
        while pattern.startswith("../"):
            pattern, place = pattern[3:], place.parent
        if next(place.glob(pattern), None) is None:
            yield needed, f"{what}: {place / pattern}"
