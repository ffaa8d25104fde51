"""``RefinementSettings``: everything that can be chosen about the refinement of a depth network."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from prgbd.core.errors import ConfigError
from prgbd.core.options import check_types
from prgbd.training.objective import METHOD, Nodes, loss_weights, make_augmentations, make_terms


@dataclass(frozen=True)
class RefinementSettings:
    """Options of depth refinement; the defaults are the paper's.

    Attributes:
        loss: Loss terms, name -> options, see ``objective``; a term of weight 0 is not computed.
        augmentation: Augmentations, name -> options, likewise.
        learning_rate: Of Adam.
        epochs: Passes over the keyframes.
        batch_size: Keyframes per step (pre-training's 12); three images per keyframe pass through the network.
        augment: Mirror half of the samples and jitter the colours of half of them, besides what ``augmentation`` names.
        freeze_batchnorm: Keep the statistics of batch normalisation as pre-training left them. By default they follow
            the batches, as in pre-training: on the synthetic street (38 keyframes, 3 epochs at 5e-5, photometric) that
            took Abs Rel from 0.203 to 0.183, frozen statistics to 0.209. Freeze them for batches of one or two.
        measure_batchnorm: Measure those statistics anew on the keyframes that trained, once the training is over; see
            ``batch_statistics.measure_batch_statistics``. Without effect where they are frozen.
        workers: Processes that load batches; images lie decoded in memory, so 0 is usually fastest.
        seed: Of shuffling, augmentation and the automatic mask.
        val_fraction: Part of the keyframes that is held out for the label-free criterion; 0 measures it on the
            training samples.
        align_scale: Multiply SLAM's geometry by the median ratio of predicted to SLAM depth before training. None does
            so for ``mono`` results alone, whose scale is arbitrary; pseudo RGB-D is in the network's own scale.
        min_keyframes: Outlier removal: fewest keyframes that must observe a point.
        max_reprojection_error: Outlier removal: pixels.
        keyframe_gap: How many keyframes away the neighbouring keyframes are.
        frame_gap: How many frames away the temporally adjacent frames are (the paper: 1); 0 measures how many it takes
            to see the scene from another place, see ``supervision.measured_gap``.
        min_common_points: Points that a neighbouring keyframe should share with the current one.
        consistency_points: ``common`` (the paper) or ``all``, which points depth consistency compares; see
            ``supervision.keyframe_samples``.
        min_parallax: Degrees under which SLAM must have seen a point; 0 limits its depth to what the sensor measured
            instead. See ``supervision.keyframe_samples``.
        memory_mb: Decoded images beyond this lie in a file instead of memory.
        channels_last: Memory layout of the network's images that convolutions are faster in on most processors.
        compile: Compile the network with ``torch.compile``: about a minute once, then faster steps.
        checkpoint: Keep the Lightning checkpoint of the last epoch.
        checkpoint_minutes: A refinement that is stopped goes on from at most this many minutes before; 0 saves its
            state after every step.

    Raises:
        ConfigError: If a value cannot work.
    """

    loss: Nodes = field(default_factory=lambda: dict(METHOD))
    augmentation: Nodes = field(default_factory=dict)
    learning_rate: float = 1e-6
    epochs: int = 1
    batch_size: int = 12
    augment: bool = False
    freeze_batchnorm: bool = False
    measure_batchnorm: bool = False
    workers: int = 0
    seed: int = 0
    val_fraction: float = 0.1
    align_scale: bool | None = None
    min_keyframes: int = 3
    max_reprojection_error: float = 3.0
    keyframe_gap: int = 1
    frame_gap: int = 1
    min_common_points: int = 20
    consistency_points: Literal["common", "all"] = "common"
    min_parallax: float = 0.0
    memory_mb: int = 1024
    channels_last: bool = True
    compile: bool = False
    checkpoint: bool = False
    checkpoint_minutes: float = 2.0

    def __post_init__(self) -> None:
        check_types(self, "training")
        positive = ("learning_rate", "epochs", "batch_size", "min_keyframes", "max_reprojection_error")
        for name in (*positive, "keyframe_gap"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ConfigError(f"training.{name} is {getattr(self, name)}; it must be positive.")
        for name in ("frame_gap", "workers", "min_common_points", "memory_mb", "checkpoint_minutes"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"training.{name} is {getattr(self, name)}; it must be 0 or positive.")
        if not 0 <= self.min_parallax < 90:
            raise ConfigError(f"training.min_parallax is {self.min_parallax}; it must lie between 0 and 90 degrees.")
        if not 0 <= self.val_fraction <= 0.5:
            raise ConfigError(f"training.val_fraction is {self.val_fraction}; it must lie between 0 and 0.5.")

    def check_plugins(self) -> None:
        """Make the loss terms and augmentations once, which imports them, so that what cannot work is found early.

        Raises:
            PrgbdError: If there is no such plug-in, or an option has a value that cannot work.
        """
        make_terms(self.loss)
        make_augmentations(self.augmentation, self.augment)

    @property
    def weights(self) -> dict[str, float]:
        """The weight of every loss term by its name."""
        return loss_weights(self.loss)
