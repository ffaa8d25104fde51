import pytest
import torch
from torch import nn

from prgbd.training.batch_statistics import measure_batch_statistics


def network():
    torch.manual_seed(0)
    return nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.Dropout(0.5), nn.Conv2d(4, 2, 1), nn.BatchNorm2d(2))


def images(count):
    return list(torch.rand(count, 6, 3, 8, 8, generator=torch.Generator().manual_seed(1)))


def test_they_are_the_means_over_the_batches():
    net, batches = network(), images(5)
    with torch.no_grad():
        maps = [net[0](batch) for batch in batches]
    assert measure_batch_statistics(net, batches) == 2
    first = net[1]
    torch.testing.assert_close(first.running_mean, torch.stack([m.mean((0, 2, 3)) for m in maps]).mean(0))
    torch.testing.assert_close(first.running_var, torch.stack([m.var((0, 2, 3)) for m in maps]).mean(0))


def test_evaluation_then_gives_what_the_batch_itself_gives():
    net, (batch,) = network(), images(1)
    measure_batch_statistics(net, [batch])
    net.eval()
    evaluated = net(batch)
    for layer in (net[1], net[4]):
        layer.train()
    torch.testing.assert_close(evaluated, net(batch), rtol=1e-2, atol=5e-3)  # n and n - 1 pixels in a variance


def test_all_else_stays():
    net = network()
    net[1].eval()
    net[1].momentum = 0.3
    before = {name: value.clone() for name, value in net.named_parameters()}
    modes = [module.training for module in net.modules()]
    measure_batch_statistics(net, images(2))
    assert [module.training for module in net.modules()] == modes
    assert net[1].momentum == 0.3
    assert all(torch.equal(value, before[name]) and value.grad is None for name, value in net.named_parameters())


def test_an_error_leaves_the_modes_as_they_were():
    net = network()
    with pytest.raises(RuntimeError):
        measure_batch_statistics(net, [torch.rand(1, 5, 8, 8)])
    assert all(module.training for module in net.modules())
    assert net[1].momentum == 0.1


def test_a_network_without_such_layers_is_not_called():
    def refuse(*_):
        raise AssertionError

    net = nn.Conv2d(3, 1, 1)
    net.register_forward_hook(refuse)
    assert measure_batch_statistics(net, images(1)) == 0
    assert measure_batch_statistics(nn.Sequential(nn.BatchNorm2d(3, track_running_stats=False)), images(1)) == 0
