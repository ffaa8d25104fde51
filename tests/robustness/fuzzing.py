"""What the property-based tests share: how many inputs they try, and how an outcome is judged.

A test of this folder looks like::

    @examples(small=25, large=400)
    @given(values=st.lists(st.floats()))
    def test_time_lists(values):
        with judged("time lists"):
            read_times(values)

``make test`` tries ``small`` inputs, the same each time; ``make fuzz`` tries ``large``, other ones each time, or as
many as fit into ``SECONDS``.
"""

from __future__ import annotations

import contextlib
import functools
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator

from hypothesis import HealthCheck, Phase, settings

from prgbd.core.errors import PrgbdError

LARGE = os.environ.get("PRGBD_FUZZ") == "large"
SECONDS = 80.0  # of one property-based test in `make fuzz`; inputs that are whole runs take most of them
ROUNDS = 10  # in which the inputs of a test are tried, so that it can stop between two
LONGEST = 700  # characters of a sentence that somebody still reads
ACCEPTED, REFUSED = "accepted", "refused"

TALLY: Counter[tuple[str, str]] = Counter()
"""How many inputs of each subject had which outcome."""


def examples(small: int, large: int) -> Callable:
    """Decorate a property-based test with the number of inputs in ``make test`` and in ``make fuzz``."""

    def decorate(test: Callable) -> Callable:
        if not LARGE:
            return _profile(small)(test)
        return repeated(_profile(max(1, large // ROUNDS))(test), SECONDS)

    return decorate


def _profile(inputs: int) -> settings:
    return settings(
        max_examples=inputs,
        derandomize=not LARGE,
        deadline=None,
        database=None,
        phases=(Phase.explicit, Phase.generate, Phase.shrink) if LARGE else (Phase.explicit, Phase.generate),
        suppress_health_check=list(HealthCheck),
    )


def repeated(test: Callable, seconds: float) -> Callable:
    """Return a test that runs ``ROUNDS`` times, each with other inputs, or until its time is over."""

    @functools.wraps(test)
    def rounds(*args, **kwargs) -> None:
        end = time.monotonic() + seconds
        for _ in range(ROUNDS):
            test(*args, **kwargs)
            if time.monotonic() > end:
                return

    return rounds


def count(small: int, large: int) -> int:
    """Return how many inputs a test that is no property-based one should try."""
    return large if LARGE else small


@contextlib.contextmanager
def judged(subject: str) -> Iterator[None]:
    """Count an input as accepted or as refused by one sentence; every other outcome fails the test.

    Args:
        subject: What the input is, for the table that is printed at the end.
    """
    try:
        yield
    except PrgbdError as error:
        check_sentence(str(error))
        TALLY[subject, REFUSED] += 1
    else:
        TALLY[subject, ACCEPTED] += 1


def judged_exit(subject: str, code: int, output: str, accepted: tuple[int, ...] = (0,)) -> None:
    """Judge a whole command by its exit code and by what it printed to the error stream.

    Args:
        subject: As for ``judged``.
        code: The exit code.
        output: The error stream.
        accepted: Exit codes that are no refusal.
    """
    assert "Traceback" not in output, output
    assert code in accepted or code > 0, f"ended by signal {-code}:\n{output}"
    if code in accepted:
        TALLY[subject, ACCEPTED] += 1
    else:
        assert output.strip(), f"exit code {code} without a word"
        TALLY[subject, REFUSED] += 1


def check_sentence(text: str) -> None:
    """Assert that an error is a sentence for a person."""
    assert text.strip(), "an error without a word"
    assert len(text) <= LONGEST, f"{len(text)} characters:\n{text}"
    assert "Traceback" not in text, text
    assert " object at 0x" not in text, text


def table() -> list[str]:
    """Return the lines that tell how many inputs were tried."""
    subjects = sorted({subject for subject, _ in TALLY})
    if not subjects:
        return []
    width = max(len(subject) for subject in subjects)
    lines = [
        f"{subject:{width}}  {TALLY[subject, ACCEPTED]:6d} accepted  {TALLY[subject, REFUSED]:6d} refused in a sentence"
        for subject in subjects
    ]
    return [*lines, f"{sum(TALLY.values())} inputs of {len(subjects)} kinds"]
