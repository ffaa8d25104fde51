"""Ranges that are declared with the types of options."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest

from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Count, NotNegative, Positive, Range, Share
from prgbd.core.options import check_types, from_mapping


@dataclass(frozen=True)
class Options:
    count: Count = 1
    gap: Positive = 1.0
    sigma: NotNegative | Literal["auto"] = "auto"
    part: Share | None = None
    ratio: Annotated[float, Range(1, 10, without=1)] = 1.2
    caps: tuple[Positive, ...] = ()
    free: float = 0.0
    number: int = 0


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("count", 0, "a whole number from 1 to 1000000000"),
        ("count", math.nan, "a whole number from 1 to 1000000000"),
        ("count", 1e10, "a whole number from 1 to 1000000000"),
        ("gap", 0, "a positive number"),
        ("gap", "nan", "a positive number"),
        ("sigma", -1, "a number, 0 or more or auto"),
        ("part", 1.5, "a number from 0 to 1 or null"),
        ("ratio", 1.0, "a number from 1 to 10, without 1"),
        ("caps", [3, -1], "a list of positive numbers"),
        ("free", math.nan, "a number"),
        ("free", math.inf, "a number and finite"),
        ("number", math.inf, "a whole number"),
        ("number", 10**30, "a whole number of 64 bits"),
        pytest.param("number", 10**5000, "a whole number of 64 bits", id="thousands of digits"),
    ],
)
def test_values_out_of_range_are_refused_in_one_sentence(name: str, value: object, wanted: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        from_mapping(Options, {name: value}, "slam")
    assert str(refusal.value).startswith(f"slam.{name} is ")
    assert f"it must be {wanted}" in str(refusal.value)
    assert len(str(refusal.value)) < 400


def test_the_ends_of_a_range_belong_to_it() -> None:
    made = from_mapping(Options, {"count": 10**9, "gap": 1e-300, "sigma": 0, "part": 1, "ratio": 10, "caps": [1]})
    assert made == Options(10**9, 1e-300, 0.0, 1.0, 10.0, (1.0,))


def test_a_dataclass_made_from_python_is_held_to_them() -> None:
    with pytest.raises(ConfigError, match=r"^slam\.count is 0"):
        check_types(Options(count=0), "slam")
