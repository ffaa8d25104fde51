"""What the map keeps of every keyframe and of every point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.map.columns import Columns

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


class KeyframeColumns(Columns):
    """Keyframes; rows of culled ones stay, marked ``bad``, with their pose relative to ``parent``.

    ``scale`` is the product of all scales by which loops changed the map around a keyframe: lengths that were noted
    at one time are multiplied by the quotient of its value now and then. ``log_depth_scale`` is the logarithm of what
    the measured depth was divided by. ``aligned`` is the point for which a keypoint was moved to where patches agree.
    """

    cTw: FloatArray
    centre: FloatArray
    frame_index: IntArray
    timestamp: FloatArray
    map_id: NDArray[np.int32]
    bad: NDArray[np.bool_]
    parent: IntArray
    cTparent: FloatArray
    size: IntArray
    uv: NDArray[np.float32]
    octave: NDArray[np.int32]
    angle: NDArray[np.float32]
    descriptor: NDArray[np.uint64]
    depth: NDArray[np.float32]
    u_right: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    cell_start: NDArray[np.int32]
    point: IntArray
    following: IntArray
    median_depth: FloatArray
    scale: FloatArray
    log_depth_scale: FloatArray
    aligned: IntArray
    precision: NDArray[np.float32]

    def __init__(self, capacity: int, cells: int) -> None:
        super().__init__(
            cTw=((4, 4), np.float64, 0),
            centre=((3,), np.float64, 0),
            frame_index=((), np.int64, -1),
            timestamp=((), np.float64, 0),
            map_id=((), np.int32, 0),
            bad=((), np.bool_, 0),
            parent=((), np.int64, -1),
            cTparent=((4, 4), np.float64, 0),
            size=((), np.int64, 0),
            uv=((capacity, 2), np.float32, 0),
            octave=((capacity,), np.int32, 0),
            angle=((capacity,), np.float32, 0),
            descriptor=((capacity, 4), np.uint64, 0),
            depth=((capacity,), np.float32, 0),
            u_right=((capacity,), np.float32, -1),
            rgb=((capacity, 3), np.uint8, 0),
            cell_start=((cells + 1,), np.int32, 0),
            point=((capacity,), np.int64, -1),
            following=((capacity,), np.int64, -1),
            median_depth=((), np.float64, 0),
            scale=((), np.float64, 1),
            log_depth_scale=((), np.float64, 0),
            aligned=((capacity,), np.int64, -1),
            precision=((capacity,), np.float32, 1),
        )


class PointColumns(Columns):
    """Map points; culled ones are marked ``bad`` and merged ones name the point that took their place, for a while."""

    xyz: FloatArray
    normal: FloatArray
    distance_range: FloatArray
    descriptor: NDArray[np.uint64]
    rgb: NDArray[np.uint8]
    reference: IntArray
    created: IntArray
    head: IntArray
    visible: IntArray
    found: IntArray
    bad: NDArray[np.bool_]
    replaced_by: IntArray

    def __init__(self) -> None:
        super().__init__(
            xyz=((3,), np.float64, 0),
            normal=((3,), np.float64, 0),
            distance_range=((2,), np.float64, 0),
            descriptor=((4,), np.uint64, 0),
            rgb=((3,), np.uint8, 0),
            reference=((), np.int64, -1),
            created=((), np.int64, -1),
            head=((), np.int64, -1),
            visible=((), np.int64, 1),
            found=((), np.int64, 1),
            bad=((), np.bool_, 0),
            replaced_by=((), np.int64, -1),
        )
