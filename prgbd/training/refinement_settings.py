"""``RefinementSettings``: everything that can be chosen about the refinement of a depth network."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from prgbd.core.option_ranges import Count, CountOrZero, NotNegative, Positive, Range, Seed
from prgbd.core.options import check_types
from prgbd.training.objective import METHOD, Nodes, loss_weights, make_augmentations, make_terms

Auto = Literal["auto"]
AUTO: Final = "auto"


@dataclass(frozen=True)
class RefinementSettings:
    """Options of depth refinement; "auto" becomes a number by what is found, see ``learning_plan``.

    The defaults are those that served every recording that was tried; ``experiment=paper`` has the paper's.

    Attributes:
        learn: ``all``, or ``uncertainty``: leave depth as it is and learn from SLAM how wrong it is, see
            ``sigma_fit``; with ``all`` that is learnt at the end, where the network predicts it.
        loss: Loss terms, name -> options, see ``objective``; a term of weight 0 is not computed.
        augmentation: Augmentations, name -> options, likewise.
        learning_rate: Of Adam, or "auto": by how well the network knows the scene (the paper: 1e-6).
        epochs: Passes over the keyframes (the paper: 1), or "auto": as many as ``task.budget`` allows.
        batch_size: Keyframes per step; three images per keyframe pass through the network. "auto": 4, as a recording
            gives a hundred keyframes or so, and 12 (pre-training's, and the paper's) of thousands.
        augment: Mirror half of the samples and jitter the colours of half of them, as in pre-training (the paper),
            besides what ``augmentation`` names. Off, because few keyframes and epochs are better spent unaugmented:
            docs/method.md has the figures.
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
        frame_gap: How many frames away the temporally adjacent frames are (the paper: 1); 0 measures for every
            recording how many it takes to see the scene from another place, see ``supervision.measured_gap``.
        min_common_points: Points that a neighbouring keyframe should share with the current one.
        consistency_points: ``common`` (the paper) or ``all``, which points depth consistency compares; see
            ``supervision.keyframe_samples``.
        min_parallax: Degrees under which SLAM must have seen a point; 0 (the paper) leaves it to ``far_points``. See
            ``supervision.keyframe_samples``.
        far_points: What becomes of points beyond the largest depth that the network predicted: ``drop``, or ``keep``
            (the paper), which makes the next trajectory worse: docs/method.md has the figures.
        memory_mb: Decoded images beyond this lie in a file instead of memory.
        channels_last: Memory layout of the network's images that convolutions are faster in on most processors.
        compile: Compile the network with ``torch.compile``: about a minute once, then faster steps.
        checkpoint: Keep the Lightning checkpoint of the last epoch.
        checkpoint_minutes: A refinement that is stopped goes on from at most this many minutes before; 0 saves its
            state after every step.

    Raises:
        ConfigError: If a value cannot work.
    """

    learn: Literal["all", "uncertainty"] = "all"
    loss: Nodes = field(default_factory=lambda: dict(METHOD))
    augmentation: Nodes = field(default_factory=dict)
    learning_rate: Positive | Auto = AUTO
    epochs: Count | Auto = AUTO
    batch_size: Count | Auto = AUTO
    augment: bool = True
    freeze_batchnorm: bool = False
    measure_batchnorm: bool = True
    workers: CountOrZero = 0
    seed: Seed = 0
    val_fraction: Annotated[float, Range(0, 0.5)] = 0.1
    align_scale: bool | None = None
    min_keyframes: Count = 3
    max_reprojection_error: Positive = 3.0
    keyframe_gap: Count = 1
    frame_gap: CountOrZero = 0
    min_common_points: CountOrZero = 20
    consistency_points: Literal["common", "all"] = "all"
    min_parallax: Annotated[float, Range(0, 90, without=90)] = 2.0
    far_points: Literal["drop", "keep"] = "drop"
    memory_mb: CountOrZero = 1024
    channels_last: bool = True
    compile: bool = False
    checkpoint: bool = False
    checkpoint_minutes: NotNegative = 2.0

    def __post_init__(self) -> None:
        check_types(self, "training")

    def check_plugins(self) -> None:
        """Make the loss terms and augmentations once, which imports them, so that what cannot work is found early.

        Raises:
            PrgbdError: If there is no such plug-in, or an option has a value that cannot work.
        """
        make_terms(self.loss)
        make_augmentations(self.augmentation, self.augment)

    @property
    def step_size(self) -> float:
        """The learning rate, once it is a number."""
        assert self.learning_rate != AUTO
        return self.learning_rate

    @property
    def samples_per_step(self) -> int:
        """The batch size, once it is a number."""
        assert self.batch_size != AUTO
        return self.batch_size

    @property
    def weights(self) -> dict[str, float]:
        """The weight of every loss term by its name."""
        return loss_weights(self.loss)
