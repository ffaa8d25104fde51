"""How the compiled functions of the system are compiled: ``@kernel()``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

# Sums may be reordered, but NaN and infinity must stay visible. The order depends on the code around, so whatever holds
# such sums and is called by another kernel is inlined (``forceinline``): else numba would call another copy of it on
# the run that compiles than on those that load from the cache.
FAST = {"contract", "reassoc", "nsz"}

# numba lets a function that leaves one of these open inherit it from whichever kernel happens to compile it first, and
# keeps that in its cache: what a run computes would depend on what was run first after the installation.
_NEVER_INHERITED = {"fastmath": False, "forceinline": False, "error_model": "python"}


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function without the interpreter's lock, cached on disk, the same whoever calls it first.

    Args:
        **options: Options of ``numba.njit``, such as ``fastmath=FAST, forceinline=True``.

    Returns:
        The decorator.
    """
    return numba.njit(**{"cache": True, "nogil": True, **_NEVER_INHERITED, **options})
