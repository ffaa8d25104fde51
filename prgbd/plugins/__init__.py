"""The plug-ins that come with prgbd, registered by the same call as anybody's; nothing is imported here."""

from __future__ import annotations

from prgbd.core.registry import REGISTRY, PluginSpec

BUILT_IN = (
    ("depth", "monodepth2", "monodepth2:Monodepth2", "Monodepth2, ResNet-18; reads the official weight files"),
    ("depth", "rt_monodepth", "rt_monodepth:RTMonoDepth", "RT-MonoDepth-S, 1.2 M parameters, for slow machines"),
    (
        "depth",
        "huggingface",
        "huggingface:HuggingFaceDepth",
        "any depth model of Transformers: Depth Anything, DPT, ...",
    ),
    ("depth", "simulated", "simulated:SimulatedDepth", "true depth with known errors, in the place of a network"),
    ("slam", "orb_gtsam", "orb_gtsam:OrbGtsamSLAM", "ORB-SLAM2's ideas in Python with numba and GTSAM: all modes"),
    ("slam", "posenet", "posenet:PoseNetworkOdometry", "a pose network's motions, chained: the baseline without SLAM"),
    ("slam", "colmap", "colmap:ColmapSLAM", "COLMAP's structure from motion, offline, with known or unknown camera"),
    ("data", "synthetic", "synthetic:SyntheticSequence", "procedural street or indoor world with true poses and depth"),
    ("data", "kitti_odometry", "kitti_odometry:KittiOdometrySequence", "KITTI odometry sequences 00-21"),
    ("data", "kitti_raw", "kitti_raw:KittiRawSequence", "KITTI raw drives, Eigen split, velodyne depth, GPS poses"),
    ("data", "seven_scenes", "seven_scenes:SevenScenesSequence", "Microsoft 7-Scenes, hand-held Kinect"),
    ("data", "tum_rgbd", "tum_rgbd:TumRgbdSequence", "TUM RGB-D recordings, undistorted"),
    ("data", "euroc", "euroc:EurocSequence", "EuRoC MAV: stereo pairs, rectified, and the drone's true poses"),
    ("data", "rgbd", "rgbd:RgbdSequence", "a folder of colour and depth with a camera file"),
    ("data", "rosbag", "rosbag:RosbagSequence", "bags of ROS 1 and ROS 2: images, depth and camera by their topics"),
    ("data", "images", "images:ImagesSequence", "a folder of images with a camera file or a field of view"),
    ("data", "video", "video:VideoSequence", "any video file that OpenCV reads"),
    ("data", "camera", "camera:CameraSequence", "a webcam or stream, recorded first; or a video played as one"),
    ("loss", "photometric", "photometric:Photometric", "P: adjacent frames, warped by depth and pose, look alike"),
    ("loss", "smoothness", "smoothness:Smoothness", "S: depth changes where the image does"),
    ("loss", "depth_consistency", "depth_consistency:DepthConsistency", "D: depth is that of SLAM's points"),
    ("loss", "depth_transfer", "depth_transfer:DepthTransfer", "T: the depth of three keyframes agrees"),
    ("criterion", "held_out", "held_out:HeldOut", "the refinement's own loss on held-out keyframes falls"),
    ("criterion", "slam", "slam:Slam", "SLAM makes more of the refined network"),
    ("criterion", "both", "both:Both", "held_out and slam"),
    ("augmentation", "mirror", "mirror:Mirror", "left to right, with the geometry"),
    ("augmentation", "jitter", "jitter:Jitter", "brightness, contrast, saturation and hue (Monodepth2)"),
)
# The extra of pyproject.toml that a plug-in needs, and the modules that it brings.
EXTRAS: dict[tuple[str, str], tuple[str, tuple[str, ...]]] = {
    ("depth", "huggingface"): ("hf", ("transformers", "safetensors")),
    ("slam", "colmap"): ("colmap", ("pycolmap",)),
}
# The dataclass of a plug-in's options, where they are more than the keywords of its constructor.
OPTIONS = {
    ("slam", "orb_gtsam"): "prgbd.plugins.slam.orb_gtsam.settings:Settings",
    ("depth", "simulated"): "prgbd.plugins.depth.simulated.options:SensorErrors",
}

for _kind, _id, _target, _description in BUILT_IN:
    _extra, _requires = EXTRAS.get((_kind, _id), ("", ()))
    REGISTRY.register(
        PluginSpec(
            _kind,
            _id,
            f"prgbd.plugins.{_kind}.{_target}",
            _description,
            origin="built-in",
            extra=_extra,
            requires=_requires,
            options=OPTIONS.get((_kind, _id), ""),
        ),
        override=True,
    )
