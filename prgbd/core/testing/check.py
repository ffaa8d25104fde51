"""``Check``: one thing that must hold of a plug-in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One thing that must hold of a plug-in.

    Attributes:
        title: What holds if ``run`` comes back, for a listing.
        run: Raises ``ContractError`` with one sentence otherwise.
    """

    title: str
    run: Callable[[], None]
