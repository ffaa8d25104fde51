"""A refinement in two processes on the CPU."""

import pytest
import torch

from prgbd.training.refinement import refine
from prgbd.training.trainers import TrainerFactory

from .scenes import WallSequence, true_slam_result
from .test_checkpoints import QUICK, STEPS, Noisy

TWO = TrainerFactory({"strategy": "ddp_spawn", "devices": 2, "accelerator": "cpu"})


@pytest.mark.skipif(not torch.distributed.is_available(), reason="this PyTorch was built without torch.distributed")
def test_two_processes_share_the_keyframes_and_one_measures(tmp_path):
    sequence = WallSequence(27, step=0.12)
    given = [(sequence, true_slam_result(sequence))]
    network, alone = Noisy(), Noisy()
    shared = torch.multiprocessing.get_sharing_strategy()
    two = refine(network, given, QUICK, tmp_path / "two", TWO)
    one = refine(alone, given, QUICK, tmp_path / "one")
    assert torch.multiprocessing.get_sharing_strategy() == shared
    # The criterion does not depend on the number of processes; before training it is the same number.
    assert two.held_out_before == one.held_out_before
    assert two.held_out_after < two.held_out_before
    steps = [row["step"] for row in two.losses if row["split"] == "train"]
    assert steps == list(range(1, len(steps) + 1))
    assert len(steps) == QUICK.epochs * -(-STEPS // 2)  # half of the steps: each process takes half of the keyframes
    moved = [name for name, value in network.state_dict().items() if not torch.equal(value, Noisy().state_dict()[name])]
    assert moved  # the trained weights came home
