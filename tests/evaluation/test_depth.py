import json

import numpy as np
import pytest

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, ContractError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.evaluation.depth import METRICS, align_depth, depth_metrics, evaluate_depth, evaluate_depth_image

H, W = 40, 60


class Ramp(Sequence):
    """Frames whose red channel is their depth in metres; every third frame has no truth."""

    name = "ramp"

    def __init__(self, n=6):
        self.camera = PinholeCamera(W, H, 50, 50, 30, 20)
        self.timestamps = np.arange(n) * 0.1

    def frame(self, index):
        image = np.zeros((H, W, 3), np.uint8)
        image[..., 0] = np.linspace(5, 75, W).astype(int)
        return Frame(index, float(self.timestamps[index]), image)

    def depth(self, index):
        return None if index % 3 == 2 else self.frame(index).image[..., 0].astype(np.float32)


def perfect(image):
    return image[..., 0].astype(np.float32)


def test_golden_figures_of_the_published_program(golden):
    wanted = json.loads((golden / "depth_metrics_reference.json").read_text())["value"]
    i = np.arange(1000)
    gt = 5 + 3 * np.sin(i / 7) + i / 50
    found = depth_metrics(gt, gt * (1 + 0.15 * np.sin(i / 3)))
    assert found == pytest.approx(wanted, rel=1e-9)


def test_metrics_by_hand():
    found = depth_metrics(np.array([1.0, 4.0]), np.array([2.0, 4.0]))
    assert found == pytest.approx(
        {"abs_rel": 0.5, "sq_rel": 0.5, "rmse": np.sqrt(0.5), "rmse_log": np.sqrt(np.log(2) ** 2 / 2),
         "a1": 0.5, "a2": 0.5, "a3": 0.5}
    )  # fmt: skip


def test_unknown_depth_and_depth_beyond_the_cap_do_not_count():
    gt = np.full((H, W), 10, np.float32)
    pred = gt.copy()
    gt[:5], pred[:5] = 0, 3
    gt[5:8], pred[5:8] = 80, 5
    found = evaluate_depth_image(gt, pred)
    assert found["abs_rel"] == 0
    assert found["pixels"] == (H - 8) * W
    assert evaluate_depth_image(np.zeros_like(gt), pred) is None


def test_median_scaling_and_the_clamp_after_it():
    gt = np.full((H, W), 10, np.float32)
    gt[0, 0] = 79
    pred = gt / 4
    pred[0, 0] = 30  # 120 m after scaling, so it is clamped to 80
    found = evaluate_depth_image(gt, pred)
    assert found["scale"] == pytest.approx(4)
    assert found["rmse"] == pytest.approx(1 / np.sqrt(H * W), rel=1e-6)
    plain = evaluate_depth_image(gt, gt / 4, median_scaling=False)
    assert plain["abs_rel"] == pytest.approx(0.75, rel=1e-6)
    assert plain["scale"] == pytest.approx(4)


@pytest.mark.parametrize(("crop", "top"), [("garg", 0.40810811), ("eigen", 0.3324324)])
def test_crops_follow_the_published_fractions(crop, top):
    gt = np.full((375, 1242), 10, np.float32)
    pred = gt.copy()
    pred[: int(top * 375)] = 1
    pred[:, : int(0.0359477 * 1242)] = 1
    found = evaluate_depth_image(gt, pred, crop=crop)
    assert found["abs_rel"] == 0
    bottom = {"garg": 0.99189189, "eigen": 0.91351351}[crop]
    rows, columns = int(bottom * 375) - int(top * 375), int(0.96405229 * 1242) - int(0.03594771 * 1242)
    assert found["pixels"] == rows * columns
    assert evaluate_depth_image(gt, pred)["abs_rel"] > 0


def test_a_prediction_of_another_size_is_resized_as_inverse_depth():
    gt = np.full((H, W), 10, np.float32)
    pred = np.full((H // 2, W // 2), 10, np.float32)
    pred[:, W // 4 :] = 40
    truth, prediction, _ = align_depth(gt, pred, median_scaling=False)
    prediction = prediction.reshape(H, W)
    # 3/4 of one inverse depth and 1/4 of the other beside the edge
    assert prediction[0, W // 2 - 1] == pytest.approx(1 / (0.75 / 10 + 0.25 / 40))
    assert prediction[0, 0] == pytest.approx(10)
    assert truth.shape == (H * W,)


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf])
def test_impossible_predictions_break_the_contract(value):
    gt = np.full((H, W), 10, np.float32)
    pred = gt.copy()
    pred[3, 3] = value
    with pytest.raises(ContractError):
        evaluate_depth_image(gt, pred)


def test_wrong_options_are_named():
    gt = np.ones((H, W), np.float32)
    with pytest.raises(ConfigError, match="crop 'grag'"):
        evaluate_depth_image(gt, gt, crop="grag")
    with pytest.raises(ConfigError, match="cap"):
        evaluate_depth_image(gt, gt, cap=(80, 1))
    with pytest.raises(ConfigError, match="bins"):
        evaluate_depth(perfect, Ramp(), bins=[3, 2])


def test_a_sequence_gives_means_and_says_how_they_were_made():
    found = evaluate_depth(lambda image: perfect(image) / 3, Ramp())
    assert found["abs_rel"] == pytest.approx(0, abs=1e-6)
    assert (found["images"], found["images_without_truth"]) == (4, 2)
    assert (found["cap"], found["crop"], found["median_scaling"]) == ([1e-3, 80.0], "none", True)
    assert found["scale_median"] == pytest.approx(3)
    assert found["scale_std"] == pytest.approx(0, abs=1e-6)
    assert found["a1"] == 1
    json.dumps(found, allow_nan=False)


def test_the_mean_is_over_images_and_the_scale_spread_is_relative():
    class Two(Ramp):
        def depth(self, index):
            return super().depth(0) * (1 if index == 0 else 2)

    found = evaluate_depth(perfect, Two(2), median_scaling=False, cap=(1e-3, 1000))
    assert found["abs_rel"] == pytest.approx((0 + 0.5) / 2)
    assert found["scale_median"] == pytest.approx(1.5)
    assert found["scale_std"] == pytest.approx(0.5 / 1.5)


def test_an_estimator_object_and_chosen_frames():
    class Network:
        seen = 0

        def predict(self, image):
            self.seen += 1
            return perfect(image)

    network = Network()
    assert evaluate_depth(network, Ramp(), indices=[1, 2, 3])["images"] == 2
    assert network.seen == 2


def test_caps_and_bins_come_from_the_same_predictions():
    def biased(image):
        depth = perfect(image)
        return np.where(depth > 40, depth * 1.5, depth).astype(np.float32)

    found = evaluate_depth(biased, Ramp(1), median_scaling=False, caps=[30, 80], bins=[0, 40.5, 60, 200])
    near, far = found["by_cap"]
    assert (near["cap"], far["cap"]) == (30, 80)
    assert near["abs_rel"] == 0
    assert {n: far[n] for n in METRICS} == {n: found[n] for n in METRICS}
    depths = Ramp(1).depth(0)
    assert [b["pixels"] for b in found["by_depth"]] == [
        int(((depths >= a) & (depths < b)).sum()) for a, b in ((0, 40.5), (40.5, 60), (60, 200))
    ]
    assert found["by_depth"][0]["abs_rel"] == 0
    assert found["by_depth"][1]["abs_rel"] > 0.4  # clamped to 80 m beyond 53 m
    alone = evaluate_depth(biased, Ramp(1), median_scaling=False, cap=(1e-3, 30))
    assert {n: near[n] for n in METRICS} == {n: alone[n] for n in METRICS}


def test_near_and_far_pixels_share_one_scale():
    def far_too_far(image):
        depth = perfect(image)
        return np.where(depth >= 40, depth * 1.1, depth).astype(np.float32) * 3

    truth = Ramp(1).depth(0)
    mask = (truth > 1e-3) & (truth < 80)
    scale = np.median(truth[mask]) / np.median(far_too_far(Ramp(1).frame(0).image)[mask])
    found = evaluate_depth(far_too_far, Ramp(1))
    for half, pixels in (("near", mask & (truth < 40)), ("far", mask & (truth >= 40))):
        gt = truth[pixels].astype(np.float64)
        pred = np.clip(far_too_far(Ramp(1).frame(0).image)[pixels] * scale, 1e-3, 80)
        assert found[half]["pixels"] == pixels.sum() > 0
        assert np.isclose(found[half]["sq_rel"], np.mean((gt - pred) ** 2 / gt))
        assert np.isclose(found[half]["abs_rel"], np.mean(np.abs(gt - pred) / gt))
    assert found["near"]["to"] == found["far"]["from"] == 40
    total = sum(found[half]["sq_rel"] * found[half]["pixels"] for half in ("near", "far"))
    assert np.isclose(total / mask.sum(), found["sq_rel"])


def test_no_truth_gives_none_and_a_reason():
    found = evaluate_depth(perfect, Ramp(), indices=[2, 5], caps=[50], bins=[0, 80])
    assert found["abs_rel"] is None
    assert found["images"] == 0
    assert "No image" in found["reason"]
    assert found["by_cap"][0]["abs_rel"] is None
    assert found["by_depth"][0]["abs_rel"] is None


def test_scale_and_shift_of_inverse_depth():
    gt = np.linspace(2.0, 40.0, 300, dtype=np.float32).reshape(15, 20)
    pred = (1.0 / (3.0 * (1.0 / gt + 0.2))).astype(np.float32)
    assert evaluate_depth_image(gt, pred, affine=True)["abs_rel"] < 1e-4
    assert evaluate_depth_image(gt, pred)["abs_rel"] > 0.2
