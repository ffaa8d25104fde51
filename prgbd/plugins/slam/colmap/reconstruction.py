"""What COLMAP is asked to do: features, sequential matches, incremental mapping; and its model as columns."""

from __future__ import annotations

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
        camera: The camera without distortion.
        frame_index: (K,) int64 registered frames, ascending.
        wTc: (K, 4, 4) float64.
        xyz: (P, 3) float64 points.
        rgb: (P, 3) uint8.
        keyframe: (M,) int64 row of the frame of every observation.
        point: (M,) int64 row of its point.
        uv: (M, 2) float32 undistorted pixel, integers at pixel centres.
        raw_uv: (M, 2) float32 pixel in the image as it was given.
        sizes: Numbers of registered frames of all models, largest first; this one is the first.
        distortion: Coefficients that COLMAP estimated or was given, in the order of its camera model.
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
    distortion: list[float]


def image_name(index: int) -> str:
    """Return the file name of a frame; names sort as frames do, which sequential matching relies on."""
    return f"{index:08d}.png"


def reconstruct(folder: Path, camera: PinholeCamera, settings: ColmapSettings) -> Model:
    """Run COLMAP on ``folder/images`` and return the largest model.

    Args:
        folder: Folder with ``images``; the database and the models are written beside them.
        camera: The camera, used as ``settings.intrinsics`` says.
        settings: What was chosen.

    Raises:
        SlamError: If COLMAP finds no model.
    """
    pycolmap.logging.minloglevel = 3  # what it has to say would fill the terminal
    pycolmap.set_random_seed(settings.seed)
    database, images, models = folder / "database.db", folder / "images", folder / "models"
    models.mkdir()
    _extract(database, images, camera, settings)
    _match(database, settings)
    found = pycolmap.incremental_mapping(database, images, models, options=_mapping_options(settings))
    ranked = sorted(found.values(), key=lambda model: -model.num_reg_images())
    if not ranked:
        count = len(list(images.iterdir()))
        raise SlamError(
            f"COLMAP could not register any of {count} keyframes; give frames that move sideways past textured things, "
            "or set slam.every lower."
        )
    return _columns(ranked[0], camera, [int(model.num_reg_images()) for model in ranked])


def _extract(database: Path, images: Path, camera: PinholeCamera, settings: ColmapSettings) -> None:
    reader = pycolmap.ImageReaderOptions()
    if settings.intrinsics == "unknown":
        reader.camera_model = "SIMPLE_RADIAL"
    else:
        reader.camera_model, parameters = _camera_model(camera)
        reader.camera_params = ",".join(repr(float(value)) for value in parameters)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = settings.threads, False
    options.sift.max_num_features = settings.features
    mode = pycolmap.CameraMode.SINGLE
    device = pycolmap.Device.cpu
    pycolmap.extract_features(
        database, images, camera_mode=mode, reader_options=reader, extraction_options=options, device=device
    )


def _camera_model(camera: PinholeCamera) -> tuple[str, list[float]]:
    pinhole = [camera.fx, camera.fy, camera.cx + CENTRE, camera.cy + CENTRE]
    if not any(camera.distortion):
        return "PINHOLE", pinhole
    k = [*camera.distortion, 0.0, 0.0, 0.0, 0.0][:5]
    return "FULL_OPENCV", [*pinhole, *k, 0.0, 0.0, 0.0]


def _match(database: Path, settings: ColmapSettings) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads, matching.use_gpu = settings.threads, False
    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap, pairing.quadratic_overlap, pairing.loop_detection = settings.overlap, True, False
    pairing.num_threads = settings.threads
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = settings.seed
    pycolmap.match_sequential(
        database,
        matching_options=matching,
        pairing_options=pairing,
        verification_options=verification,
        device=pycolmap.Device.cpu,
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
        distortion=[float(lens.params[i]) for i in lens.extra_params_idxs()],
    )
