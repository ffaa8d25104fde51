"""Monodepth2 with ResNet-18: reads, writes and reproduces the published networks."""

from prgbd.plugins.depth.monodepth2.network import Monodepth2

__all__ = ["Monodepth2"]
