"""Procedural worlds made by prgbd itself: streets and rooms with true poses and depth."""

from prgbd.plugins.data.synthetic.sequence import SyntheticSequence

__all__ = ["SyntheticSequence"]
