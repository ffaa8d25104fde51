import threading

import numpy as np
import pytest
import torch

from prgbd import DepthPrediction
from prgbd.core.computing import Computing
from prgbd.core.errors import ContractError, DataError
from prgbd.core.slam import adaptive_baseline
from prgbd.loop.sensing import DepthSensor
from prgbd.loop.sigma_codes import LARGEST, SMALLEST, from_codes, to_codes
from tests.loop.fakes import NanDepth, Tiny, Wall, ZeroDepth


class Ramp(Tiny):
    """Depth grows with the brightness of the picture; counts its forward passes."""

    passes = 0

    def forward(self, images):
        Ramp.passes += len(images)
        return DepthPrediction((1.0 + 10 * images.mean(1, keepdim=True) + 0 * self.bias,))


@pytest.fixture(autouse=True)
def _count():
    Ramp.passes = 0


def make(estimator, tmp_path, sequence=None, **options):
    return DepthSensor(estimator, sequence or Wall(frames=5), tmp_path, name="test", **options)


def test_depth_is_the_network_s_at_the_size_of_the_image(tmp_path):
    network = Ramp()
    sensor = make(network, tmp_path)
    for index, frame in enumerate(sensor):
        assert frame.index == index
        assert frame.depth.shape == frame.image.shape[:2] == (64, 96)
        assert frame.depth.dtype == np.float32
        np.testing.assert_allclose(frame.depth, network.predict(frame.image), rtol=1e-5)


def test_the_baseline_is_the_paper_s(tmp_path):
    sensor = make(Ramp(), tmp_path)
    statistics = sensor.prepare()
    with torch.inference_mode():
        depths = [Ramp()(Ramp().preprocess(frame.image)[None]).depth.numpy() for frame in sensor]
    assert statistics.depth_max == pytest.approx(float(np.max(depths)))
    assert statistics.adaptive_baseline == pytest.approx(0.54 / 80 * np.max(depths))
    assert adaptive_baseline(80.0) == pytest.approx(0.54)
    np.testing.assert_allclose(statistics.median, [np.median(d) for d in depths], rtol=1e-6)


def test_percentile_of_all_pixels(tmp_path):
    sensor = make(Ramp(), tmp_path, percentile=90)
    with torch.inference_mode():
        depths = [Ramp()(Ramp().preprocess(frame.image)[None]).depth.numpy() for frame in sensor]
    assert sensor.prepare().depth_max == pytest.approx(float(np.percentile(depths, 90)), rel=1e-3)


@pytest.mark.parametrize("size", [1, 2, 5, 8])
def test_batches_make_no_difference(tmp_path, size):
    network = Tiny()
    one = make(network, tmp_path / "b", batch_size=1).depth(3)
    np.testing.assert_allclose(make(network, tmp_path / "c", batch_size=size).depth(3), one, rtol=1e-5)


@pytest.mark.parametrize("threads", [1, 64])
def test_frames_come_in_order_whether_a_thread_decodes_or_not(tmp_path, monkeypatch, threads):
    monkeypatch.setattr("prgbd.loop.decoding.torch.get_num_threads", lambda: threads)
    monkeypatch.setattr("prgbd.loop.decoding.os.cpu_count", lambda: 8)
    decoded = []
    sensor = make(Tiny(), tmp_path)
    frame = sensor.sequence.frame

    def noted(index):
        decoded.append((index, threading.current_thread() is threading.main_thread()))
        return frame(index)

    monkeypatch.setattr(sensor.sequence, "frame", noted)
    sensor.prepare()
    assert decoded == [(index, threads == 64) for index in range(5)]


@pytest.mark.parametrize("concurrent", [False, True])
def test_several_threads_decode_only_where_the_recording_allows_it(tmp_path, monkeypatch, concurrent):
    monkeypatch.setattr("prgbd.loop.decoding.torch.get_num_threads", lambda: 2)
    monkeypatch.setattr("prgbd.loop.decoding.os.cpu_count", lambda: 2)
    network = Tiny()
    sensor, alone = (make(network, tmp_path / name, batch_size=4) for name in ("a", "b"))
    sensor.sequence.concurrent = concurrent
    frame, meeting, met = sensor.sequence.frame, threading.Barrier(2), []

    def noted(index):
        if concurrent and index < 4:
            meeting.wait(10)  # nobody comes alone
        met.append(threading.current_thread() is threading.main_thread())
        return frame(index)

    monkeypatch.setattr(sensor.sequence, "frame", noted)
    sensor.prepare()
    # Five frames in batches of four: the last one needs no thread.
    assert sorted(met) == ([False] * 4 + [True] if concurrent else [True] * 5)
    monkeypatch.undo()
    for index in range(5):
        np.testing.assert_array_equal(sensor.depth(index), alone.depth(index))


def test_a_frame_is_predicted_once_and_again_only_for_other_weights_or_frames(tmp_path):
    network = Ramp()
    for _ in range(2):
        sensor = make(network, tmp_path)
        sensor.prepare()
        list(sensor)
    assert Ramp.passes == 5
    make(network, tmp_path, percentile=50).prepare()
    assert Ramp.passes == 5
    make(network, tmp_path, Wall(frames=5, seed=9)).prepare()
    assert Ramp.passes == 10
    with torch.no_grad():
        network.bias.add_(1e-6)
    make(network, tmp_path).prepare()
    assert Ramp.passes == 15


def test_forget_deletes_the_files(tmp_path):
    sensor = make(Ramp(), tmp_path / "cache")
    sensor.depth(0)
    assert len(list((tmp_path / "cache").iterdir())) == 2
    sensor.forget()
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize("cls", [NanDepth, ZeroDepth])
def test_spoilt_depth_names_plugin_and_frame_and_leaves_nothing(tmp_path, cls):
    with pytest.raises(ContractError, match=r"'test'.*frame 2 of 'wall'"):
        make(cls(), tmp_path / "cache").prepare()
    assert list((tmp_path / "cache").iterdir()) == []


def test_the_passive_check_s_sentence_gains_the_frame(tmp_path):
    from prgbd.core.testing.passive import with_checks

    class Negative(Tiny):
        def forward(self, images):
            return DepthPrediction((-super().forward(images).depth,))

    with pytest.raises(ContractError, match=r"zero, negative.*frame 0 of 'wall'"):
        make(with_checks("depth", "negative", Negative()), tmp_path).prepare()


def test_scale_drift_is_told(tmp_path):
    class Drifting(Tiny):
        frame = 0

        def predict(self, image):
            Drifting.frame += 1
            return np.full(image.shape[:2], 4.0 if Drifting.frame > 3 else 2.0, np.float32)

    found = make(Drifting(), tmp_path).prepare().diagnostics()
    assert found["largest_scale_step"] == pytest.approx(1.0)
    assert (found["median_depth_lowest"], found["median_depth_highest"]) == (2.0, 4.0)


def test_training_mode_is_left_as_it_was(tmp_path):
    network = Ramp().train()
    make(network, tmp_path).prepare()
    assert network.training


def test_half_precision_has_a_cache_of_its_own(tmp_path):
    network = Ramp()
    exact = make(network, tmp_path)
    half = make(network, tmp_path, computing=Computing("bfloat16", channels_last=True))
    assert exact.path != half.path
    assert exact.path == make(network, tmp_path, computing=Computing()).path
    assert half.depth(0).dtype == np.float32
    assert Ramp.passes == 5


class Sensed(Tiny):
    """Notes how it is called."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def forward(self, images):
        last = images.is_contiguous(memory_format=torch.channels_last)
        self.calls.append((torch.is_autocast_enabled("cpu"), torch.is_grad_enabled(), self.training, last))
        return super().forward(images)


def test_the_network_is_called_as_chosen_and_left_as_it_was(tmp_path):
    network = Sensed().train()
    make(network, tmp_path, computing=Computing("bfloat16", channels_last=True)).prepare()
    make(network, tmp_path, computing=Computing()).prepare()
    assert network.calls[:2] == [(True, False, False, True)] * 2  # four frames and one
    assert network.calls[2:] == [(False, False, False, False)] * 5
    assert network.training
    assert torch.is_grad_enabled()
    assert not torch.is_autocast_enabled("cpu")


def test_an_error_leaves_no_mode_behind(tmp_path):
    with pytest.raises(ContractError):
        make(NanDepth(), tmp_path, computing=Computing("bfloat16")).prepare()
    assert torch.is_grad_enabled()
    assert not torch.is_autocast_enabled("cpu")
    assert not torch.is_inference_mode_enabled()


def test_an_image_that_cannot_be_read_is_told_as_ever(tmp_path):
    class Torn(Wall):
        def frame(self, index):
            if index == 3:
                raise DataError("frame 3 is torn")
            return super().frame(index)

    with pytest.raises(DataError, match="frame 3 is torn"):
        make(Tiny(), tmp_path, Torn(frames=5)).prepare()
    assert list(tmp_path.iterdir()) == []


def test_the_network_is_asked_for_its_finest_scale_alone(tmp_path):
    class Asked(Tiny):
        asked = ()

        def forward(self, images):
            self.asked += (self.only_finest,)
            return super().forward(images)

    network = Asked()
    make(network, tmp_path).prepare()
    assert set(network.asked) == {True}
    assert not network.only_finest


class Unsure(Ramp):
    """Says that its depth is the more wrong the darker the picture; ``spoilt`` is what it says at one pixel."""

    spoilt = None

    def forward(self, images):
        sigma = 0.3 - 0.25 * images.mean(1, keepdim=True)
        if self.spoilt is not None:
            sigma[..., 3, 3] = self.spoilt
        return DepthPrediction(super().forward(images).depths, sigma=sigma)


def test_deviations_come_with_the_frame_and_from_the_cache(tmp_path):
    network = Unsure()
    for _ in range(2):
        sensor = make(network, tmp_path)
        for frame in sensor:
            depth, sigma = network.predict_with_sigma(frame.image)
            np.testing.assert_allclose(frame.depth, depth, rtol=1e-5)
            assert frame.depth_sigma.dtype == np.float32
            np.testing.assert_allclose(frame.depth_sigma, sigma, rtol=0.018)
        assert sensor.prepare().diagnostics()["median_sigma"] == pytest.approx(np.median(sigma), rel=0.1)
    assert Ramp.passes == 3 * 5  # the sensor's own five, and those that it is compared with
    assert (tmp_path / f"{sensor.path.stem}-sigma.npy").stat().st_size < 1000 + 5 * 32 * 64
    sensor.forget()
    assert not tmp_path.exists()


def test_a_network_without_deviations_gives_none(tmp_path):
    sensor = make(Ramp(), tmp_path)
    assert sensor.frame(0).depth_sigma is None
    assert "median_sigma" not in sensor.prepare().diagnostics()


@pytest.mark.parametrize("spoilt", [0.0, -1.0, float("nan"), float("inf")])
def test_spoilt_deviations_name_plugin_and_frame_and_leave_nothing(tmp_path, spoilt):
    network = Unsure()
    network.spoilt = spoilt
    with pytest.raises(ContractError, match=r"'test'.*frame 0 of 'wall'.*deviations of depth"):
        make(network, tmp_path).prepare()
    assert list(tmp_path.iterdir()) == []


def test_deviations_of_some_frames_alone_are_refused(tmp_path):
    class Moody(Ramp):
        def predict_with_sigma(self, image):
            depth = self.predict(image)
            return depth, depth if Ramp.passes < 3 else None

    with pytest.raises(ContractError, match=r"frame 2 of 'wall'.*for some frames alone"):
        make(Moody(), tmp_path).prepare()


def test_damaged_deviations_are_told_with_the_mend(tmp_path):
    sensor = make(Unsure(), tmp_path)
    sensor.prepare()
    path = tmp_path / f"{sensor.path.stem}-sigma.npy"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DataError, match=f"{path.name} is damaged.*predicted again"):
        sensor.frame(0)


def test_bytes_hold_deviations_to_two_per_cent():
    sigma = np.geomspace(SMALLEST, LARGEST, 1000).astype(np.float32)
    np.testing.assert_allclose(from_codes(to_codes(sigma)), sigma, rtol=0.018)
    np.testing.assert_allclose(from_codes(to_codes(np.float32([1e-6, 1e6]))), [SMALLEST, LARGEST], rtol=1e-5)
