"""``both``: the held-out loss first, then what SLAM makes of the refined network."""

from __future__ import annotations

from prgbd.plugins.criterion.held_out import HeldOut
from prgbd.plugins.criterion.slam import Slam


class Both(Slam, HeldOut):
    """The held-out loss must fall, and so must the index of SLAM's evidence."""
