"""Options become dataclasses, or one sentence says why not."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
from omegaconf import OmegaConf
from omegaconf.errors import ValidationError

from prgbd.core.errors import ConfigError
from prgbd.core.option_errors import unknown_option, wanted
from prgbd.core.option_schema import schema
from prgbd.core.options import check_types, checked_arguments, from_mapping, option_types

if TYPE_CHECKING:
    from nowhere import Camera  # type: ignore[import-not-found]


class Colour(Enum):
    RED = 1


@dataclass(frozen=True)
class Tracking:
    levels: int = 8
    scale_factor: float = 1.2
    batch_size: int = 3

    def __post_init__(self) -> None:
        if self.levels < 1:
            raise ConfigError(f"slam.tracking.levels is {self.levels}; it must be at least 1.")


@dataclass(frozen=True)
class Options:
    tracking: Tracking = field(default_factory=lambda: Tracking(scale_factor=1.5))
    count: int = 3
    learning_rate: float = 1e-6
    flag: bool = False
    name: str = "x"
    ratio: float | None = 0.5
    features: int | Literal["auto"] = "auto"
    sigma: float | Literal["auto"] = "auto"
    outliers: bool | Literal["auto"] = "auto"
    scale: Literal["free", "fixed"] = "free"
    iterations: tuple[int, int] = (5, 10)
    caps: tuple[float, ...] | Literal["auto"] = "auto"
    names: list[str] = field(default_factory=list)
    folder: Path | None = None
    root: str | Path = "."
    colour: Colour = Colour.RED
    more: dict[str, Any] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("name", "given", "value"),
    [
        ("count", 4, 4),
        ("count", 4.0, 4),
        ("count", "4", 4),
        ("count", np.int64(4), 4),
        ("learning_rate", "1e-6", 1e-6),
        ("learning_rate", 1, 1.0),
        ("learning_rate", np.float64(0.5), 0.5),
        ("flag", True, True),
        ("flag", "yes", True),
        ("name", 2024, "2024"),
        ("ratio", None, None),
        ("ratio", 1, 1.0),
        ("features", "auto", "auto"),
        ("features", 2000, 2000),
        ("features", 2000.0, 2000),
        ("sigma", 1, 1.0),
        ("sigma", "1e-3", 1e-3),
        ("outliers", False, False),
        ("scale", "fixed", "fixed"),
        ("iterations", [1, 2.0], (1, 2)),
        ("caps", [30, 40], (30.0, 40.0)),
        ("caps", "auto", "auto"),
        ("caps", [], ()),
        ("names", ("a", 10), ["a", "10"]),
        ("folder", "here", Path("here")),
        ("root", "here", "here"),
        ("root", Path("here"), Path("here")),
        ("colour", "RED", Colour.RED),
        ("more", {"a": [1, {"b": None}]}, {"a": [1, {"b": None}]}),
        ("tracking", {"levels": 4}, Tracking(4, 1.5)),
        ("tracking", Tracking(5), Tracking(5)),
    ],
)
def test_values_get_the_types_of_their_fields(name, given, value):
    made = getattr(from_mapping(Options, {name: given}, "slam"), name)
    assert made == value
    assert type(made) is type(value)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"count": 1.5}, "slam.count is 1.5; it must be a whole number."),
        ({"count": True}, "slam.count is True; it must be a whole number."),
        ({"count": None}, "slam.count is None; it must be a whole number."),
        ({"learning_rate": "fast"}, "slam.learning_rate is 'fast'; it must be a number."),
        ({"learning_rate": [1]}, "slam.learning_rate is [1]; it must be a number."),
        ({"flag": 1}, "slam.flag is 1; it must be true or false."),
        ({"flag": "perhaps"}, "slam.flag is 'perhaps'; it must be true or false."),
        ({"name": [1]}, "slam.name is [1]; it must be text."),
        ({"ratio": "x"}, "slam.ratio is 'x'; it must be a number or null."),
        ({"features": "many"}, "slam.features is 'many'; it must be a whole number or auto."),
        ({"features": True}, "slam.features is True; it must be a whole number or auto."),
        ({"outliers": 3.5}, "slam.outliers is 3.5; it must be true or false or auto."),
        ({"scale": "loose"}, "slam.scale is 'loose'; it must be free or fixed."),
        ({"iterations": [1]}, "slam.iterations is [1]; it must be a list of 2 whole numbers."),
        ({"iterations": [1, "x"]}, "slam.iterations is [1, 'x']; it must be a list of 2 whole numbers."),
        ({"caps": 30}, "slam.caps is 30; it must be a list of numbers or auto."),
        ({"names": "abc"}, "slam.names is 'abc'; it must be a list of texts."),
        ({"tracking": 3}, "slam.tracking is 3; it must be a group of options."),
        ({"tracking": {"levels": "x"}}, "slam.tracking.levels is 'x'; it must be a whole number."),
        ({"tracking": {"levels": 0}}, "slam.tracking.levels is 0; it must be at least 1."),
        ({"lr": 1}, "There is no option 'slam.lr'; did you mean 'slam.learning_rate'?"),
        ({"cuont": 1}, "There is no option 'slam.cuont'; did you mean 'slam.count'?"),
        ({"tracking": {"bs": 1}}, "There is no option 'slam.tracking.bs'; did you mean 'slam.tracking.batch_size'?"),
        ({"levels": 1}, "There is no option 'slam.levels'; did you mean 'slam.tracking.levels'?"),
    ],
    ids=str,
)
def test_what_cannot_work_is_said_in_one_sentence_with_the_full_name(given, sentence):
    with pytest.raises(ConfigError) as caught:
        from_mapping(Options, given, "slam")
    assert str(caught.value) == sentence


def test_nothing_given_is_the_defaults_and_the_prefix_may_be_empty():
    assert from_mapping(Options, {}, "slam") == Options()
    with pytest.raises(ConfigError, match=r"^count is 'x'; "):
        from_mapping(Options, {"count": "x"})


def test_an_option_without_default_is_asked_for():
    @dataclass
    class Needy:
        root: str

    with pytest.raises(ConfigError, match=r"The option data\.root has no default; add data\.root="):
        from_mapping(Needy, {}, "data")


def test_a_name_that_is_like_no_other_gets_them_all():
    assert "there are 'a.one', 'a.two'." in str(unknown_option("a.qqqqqq", ["a.two", "b.three", "a.one"]))
    assert "'task.max_loops'" in str(unknown_option("max_loops", ["task.max_loops", "seed"]))


def plugin(root: str, width: int = 3, *, camera: Camera = None, size=(1, 2), rate: float | None = None):
    """A plug-in's constructor."""


def test_arguments_of_a_signature_are_checked_and_others_pass():
    camera = object()
    given = {"root": "r", "width": 4.0, "camera": camera, "size": (3, 4), "rate": "1e-3"}
    assert checked_arguments(plugin, given, "data") == {**given, "width": 4, "rate": 1e-3}
    assert checked_arguments(lambda **kwargs: None, {"x": 1}, "data") == {"x": 1}


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"root": "r", "width": "x"}, r"data\.width is 'x'; it must be a whole number\."),
        ({"root": "r", "widht": 1}, r"There is no option 'data\.widht'; did you mean 'data\.width'\?"),
        ({}, r"The option data\.root has no default"),
    ],
)
def test_arguments_that_a_signature_does_not_take(given, sentence):
    with pytest.raises(ConfigError, match=sentence):
        checked_arguments(plugin, given, "data")


def test_the_schema_has_names_defaults_and_types():
    node = OmegaConf.structured(schema(Options))
    plain = OmegaConf.to_container(node)
    assert plain["tracking"] == {"levels": 8, "scale_factor": 1.5, "batch_size": 3}
    assert from_mapping(Options, plain, "slam") == Options()
    node.tracking.levels = 4
    node.count = 3.0
    with pytest.raises(ValidationError):
        node.learning_rate = "fast"
    with pytest.raises(ValidationError):
        node.tracking.levels = "x"


def test_a_schema_may_have_fewer_fields_and_more():
    plain = OmegaConf.to_container(OmegaConf.structured(schema(Tracking, without=["levels"], name="t")))
    assert plain == {"scale_factor": 1.2, "batch_size": 3, "name": "t"}


@pytest.mark.parametrize("wrong", [{"count": 1.5}, {"flag": "yes"}, {"features": "many"}, {"scale": "loose"}])
def test_types_of_what_was_made_from_python(wrong):
    check_types(Options(learning_rate=1, caps=[3, 4]), "slam")
    with pytest.raises(ConfigError, match=rf"^slam\.{next(iter(wrong))} is "):
        check_types(Options(**wrong), "slam")


def test_all_names():
    assert list(option_types(Options, "slam"))[:4] == [
        "slam.tracking.levels",
        "slam.tracking.scale_factor",
        "slam.tracking.batch_size",
        "slam.count",
    ]


def test_words_for_types():
    assert wanted(Literal["a", "b", "c"]) == "a, b or c"
    assert wanted(tuple[float, float]) == "a list of 2 numbers"
    assert wanted(Path) == "a file or folder"


def test_importing_it_is_light():
    code = "import sys, prgbd.core.options; print({'omegaconf', 'torch', 'numpy', 'hydra'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "set()"
