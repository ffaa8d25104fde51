"""What COLMAP is asked to do: features, matches in frame order, incremental mapping; and its model as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from prgbd.core.errors import SlamError
from prgbd.core.types import PinholeCamera

CENTRE = 0.5
"""COLMAP's pixel centres lie at half-integers, prgbd's at integers."""
IMAGES_AT_ONCE = 8
"""Images that COLMAP is given in one call: it tells nothing before it has done them all."""

Tell = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is to do."""


@dataclass(frozen=True)
class ColmapSettings:
    """What may be chosen of a reconstruction; see ``conf/slam/colmap.yaml``."""

    intrinsics: str
    features: int
    overlap: int
    init_max_forward_motion: float
    init_min_tri_angle: float
    min_model_size: int
    threads: int
    seed: int


@dataclass(frozen=True)
class Model:
    """A reconstruction as columns, in COLMAP's own scale.

    Attributes:
        camera: The camera, with the distortion of the images in OpenCV's order.
        frame_index: (K,) int64 registered frames, ascending.
        wTc: (K, 4, 4) float64.
        xyz: (P, 3) float64 points.
        rgb: (P, 3) uint8.
        keyframe: (M,) int64 row of the frame of every observation.
        point: (M,) int64 row of its point.
        uv: (M, 2) float32 undistorted pixel, integers at pixel centres.
        raw_uv: (M, 2) float32 pixel in the image as it was given.
        sizes: Numbers of registered frames of all models, largest first; this one is the first.
        lens: COLMAP's camera with the distortion that it estimated or was given.
    """

    camera: PinholeCamera
    frame_index: NDArray[np.int64]
    wTc: NDArray[np.float64]
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    keyframe: NDArray[np.int64]
    point: NDArray[np.int64]
    uv: NDArray[np.float32]
    raw_uv: NDArray[np.float32]
    sizes: list[int]
    lens: Any


def image_name(index: int) -> str:
    """Return the file name of a frame; names sort as frames do, which sequential matching relies on."""
    return f"{index:08d}.png"


def reconstruct(
    folder: Path, positions: list[int], camera: PinholeCamera, settings: ColmapSettings, tell: Tell
) -> Model:
    """Run COLMAP on some images of ``folder/images`` and return the largest model.

    Args:
        folder: Folder with ``images``; the database and the models are written beside them.
        positions: The frames to use, ascending.
        camera: The camera, used as ``settings.intrinsics`` says.
        settings: What was chosen.
        tell: Told of the progress.

    Raises:
        SlamError: If COLMAP finds no model.
    """
    pycolmap.logging.minloglevel = 3  # what it has to say would fill the terminal
    pycolmap.set_random_seed(settings.seed)
    database, images, models = folder / "database.db", folder / "images", folder / "models"
    models.mkdir()
    names = [image_name(position) for position in positions]
    _extract(database, images, names, camera, settings, tell)
    _match(database, names, settings, tell)
    found = _map(database, images, models, len(names), settings, tell)
    ranked = sorted(found.values(), key=lambda model: -model.num_reg_images())
    if not ranked:
        raise SlamError(
            f"COLMAP could not register any of {len(names)} keyframes; give frames that move sideways past textured "
            "things, or set slam.every lower."
        )
    return _columns(ranked[0], camera, [int(model.num_reg_images()) for model in ranked])


def _extract(
    database: Path, images: Path, names: list[str], camera: PinholeCamera, settings: ColmapSettings, tell: Tell
) -> None:
    reader = pycolmap.ImageReaderOptions()
    if settings.intrinsics == "unknown":
        reader.camera_model = "SIMPLE_RADIAL"
    else:
        reader.camera_model, parameters = _camera_model(camera)
        reader.camera_params = ",".join(repr(float(value)) for value in parameters)
    pycolmap.Database.open(database).close()
    # Numbered here, in order: threads that extract features would number images as they finish.
    pycolmap.import_images(database, images, pycolmap.CameraMode.SINGLE, names, reader)
    reader.existing_camera_id = 1  # all images share one camera
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = settings.threads, False
    options.sift.max_num_features = settings.features
    for begin in range(0, len(names), IMAGES_AT_ONCE):
        tell("COLMAP features", begin, len(names))
        pycolmap.extract_features(
            database,
            images,
            image_names=names[begin : begin + IMAGES_AT_ONCE],
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
    tell("COLMAP features", len(names), len(names))


def _distortion(lens: Any) -> tuple[float, ...]:
    """Return OpenCV's coefficients of COLMAP's camera, of a model that is asked for here."""
    found = [float(lens.params[i]) for i in lens.extra_params_idxs()]
    if not any(found):
        return ()
    return (found[0], 0.0, 0.0, 0.0) if len(found) == 1 else tuple(found)


def _camera_model(camera: PinholeCamera) -> tuple[str, list[float]]:
    pinhole = [camera.fx, camera.fy, camera.cx + CENTRE, camera.cy + CENTRE]
    if not any(camera.distortion):
        return "PINHOLE", pinhole
    k = [*camera.distortion, *8 * [0.0]][:8]
    return "FULL_OPENCV", [*pinhole, *k]


def pairs_in_order(count: int, overlap: int) -> list[tuple[int, int]]:
    """Return the pairs of images to match: each with those 1, 2, 4, 8, ... further on, ``overlap`` of them.

    These are COLMAP's own sequential pairs with quadratic overlap, (first, second) with first < second, in order.
    """
    distances = [2**power for power in range(min(overlap, 30))]
    return [(first, first + d) for first in range(count) for d in distances if first + d < count]


def _match(database: Path, names: list[str], settings: ColmapSettings, tell: Tell) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads, matching.use_gpu = settings.threads, False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = settings.seed
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(database.with_name("pairs.txt"))
    pairs = pairs_in_order(len(names), settings.overlap)
    at_once = IMAGES_AT_ONCE * settings.overlap
    for begin in range(0, len(pairs), at_once):
        tell("COLMAP matches", begin, len(pairs))
        lines = [f"{names[a]} {names[b]}\n" for a, b in pairs[begin : begin + at_once]]
        Path(pairing.match_list_path).write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(
            database,
            matching_options=matching,
            pairing_options=pairing,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )
    tell("COLMAP matches", len(pairs), len(pairs))


def _map(
    database: Path, images: Path, models: Path, count: int, settings: ColmapSettings, tell: Tell
) -> dict[int, pycolmap.Reconstruction]:
    """Register image after image, with local and global bundle adjustments between them."""
    registered = 0

    def advance(more: int) -> None:
        nonlocal registered
        # A model that is begun anew registers images again.
        registered = min(registered + more, count)
        tell("COLMAP mapping", registered, count)

    tell("COLMAP mapping", 0, count)
    return dict(
        pycolmap.incremental_mapping(
            database,
            images,
            models,
            options=_mapping_options(settings),
            initial_image_pair_callback=lambda: advance(2),
            next_image_callback=lambda: advance(1),
        )
    )


def _mapping_options(settings: ColmapSettings) -> pycolmap.IncrementalPipelineOptions:
    """Relax what keeps COLMAP from starting on a car's forward motion (colmap/colmap#568)."""
    options = pycolmap.IncrementalPipelineOptions()
    # One thread: sums in another order would give another model.
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = settings.seed
    options.min_model_size = settings.min_model_size
    options.mapper.init_max_forward_motion = settings.init_max_forward_motion
    options.mapper.init_min_tri_angle = settings.init_min_tri_angle
    refine = settings.intrinsics != "given"
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine
    options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = refine
    options.ba_refine_principal_point = False
    return options


def _columns(model: pycolmap.Reconstruction, given: PinholeCamera, sizes: list[int]) -> Model:
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: image.name)
    lens: Any = images[0].camera  # all images share it
    camera = PinholeCamera(
        given.width,
        given.height,
        float(lens.focal_length_x),
        float(lens.focal_length_y),
        float(lens.principal_point_x) - CENTRE,
        float(lens.principal_point_y) - CENTRE,
        _distortion(lens),
    )
    points = sorted(model.points3D)
    row = {point: i for i, point in enumerate(points)}
    keyframe, point, raw = [], [], []
    for k, image in enumerate(images):
        for seen in image.points2D:
            if seen.has_point3D():
                keyframe.append(k)
                point.append(row[seen.point3D_id])
                raw.append(seen.xy)
    pixels = np.array(raw, np.float64).reshape(-1, 2)
    rays = np.asarray(lens.cam_from_img(pixels), np.float64).reshape(-1, 2)
    cTw = np.tile(np.eye(4), (len(images), 1, 1))
    cTw[:, :3] = [image.cam_from_world().matrix() for image in images]
    return Model(
        camera=camera,
        frame_index=np.array([int(Path(image.name).stem) for image in images], np.int64),
        wTc=np.asarray(np.linalg.inv(cTw), np.float64),
        xyz=np.array([model.points3D[p].xyz for p in points], np.float64).reshape(-1, 3),
        rgb=np.array([model.points3D[p].color for p in points], np.uint8).reshape(-1, 3),
        keyframe=np.array(keyframe, np.int64),
        point=np.array(point, np.int64),
        uv=(rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)).astype(np.float32),
        raw_uv=(pixels - CENTRE).astype(np.float32),
        sizes=sizes,
        lens=pycolmap.Camera(lens.todict()),  # its own copy: the model is freed
    )
