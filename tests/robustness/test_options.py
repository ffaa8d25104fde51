"""Every option of every group and plug-in, with values that cannot work: the list is read from the schemas."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from prgbd.__main__ import main
from prgbd.cli.options import CommonOptions
from prgbd.cli.plugin_choices import CHOICES
from prgbd.cli.task_options import TASKS
from prgbd.core.options import checked_arguments, from_mapping, keyword_parameters, option_types
from prgbd.core.registry import KINDS, REGISTRY
from prgbd.core.wrappers import WRAPPERS
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.training.objective import make_augmentations, make_terms
from tests.robustness.fuzzing import examples, judged, judged_exit

HOSTILE: list[Any] = [
    *(math.nan, math.inf, -math.inf, -1, 0, -0.0, 0.5, 1e-320, 1e308, 10**12, 10**30, -(10**30), 10**5000),
    *(True, False, None, "", "auto", "nan", "1e400", "abc", "1,5", "a" * 3000, "\0", b"1", 1j),
    *([], [math.nan], [1, 2, 3], ["a"], [[1]], {}, {"a": 1}, {"": None}, (), range(3)),
]
TEXTS = [
    *("nan", "inf", "-inf", "-1", "0", "1e400", "1e308", "1e-320", str(10**12), "1" * 30, "1.5", "true", "null", "''"),
    *("abc", "[]", "[nan]", "[1,2,3]", "{}", "{a:1}", "'1'", "0x10", "1_000", "1e3", ".", "-", "a" * 300),
]


def nested(name: str, value: Any) -> dict[str, Any]:
    """Return the mapping that a dotted name and its value stand for."""
    first, _, rest = name.partition(".")
    return {first: nested(rest, value) if rest else value}


def readers() -> Iterator[tuple[str, Callable[[Any], Any]]]:
    """Yield every option by its dotted name, with what reads a value for it."""
    groups = [("", CommonOptions), ("slam", Settings), *(("task", task) for task in TASKS.values()), *CHOICES.items()]
    for prefix, cls in groups:
        for name in option_types(cls):
            yield f"{prefix}.{name}".strip("."), lambda v, c=cls, n=name, p=prefix: from_mapping(c, nested(n, v), p)
    for kind in KINDS:
        for spec in REGISTRY.specs(kind):
            if spec.origin != "built-in" or spec.missing or spec.options:
                continue
            given = {"root": "r"} if kind == "data" and spec.id != "synthetic" else {}
            for name in REGISTRY.options(kind, spec.id):
                read = partial(REGISTRY.checked_options, kind, spec.id)
                yield f"{kind}={spec.id}.{name}", lambda v, r=read, n=name, g=given: r({**g, n: v})
    for name, wrapper in WRAPPERS.items():
        needed = {"estimator": None, "factor": 2.0} if name == "scaled" else {"estimator": None}
        for option in keyword_parameters(wrapper):
            read = partial(checked_arguments, wrapper)
            if option != "estimator":
                yield f"depth.wrappers.{name}.{option}", lambda v, r=read, o=option, n=needed: r({**n, o: v})


EVERY = dict(readers())


UNDECLARED = ("depth_test", "camera", "loss", "augmentation", "criterion", "wrappers", "baselines")
"""Names of what takes a structure of any kind, which whoever uses it looks into."""


@examples(small=60, large=4000)
@given(name=st.sampled_from(sorted(EVERY)), value=st.sampled_from(HOSTILE))
def test_every_option(name: str, value: Any) -> None:
    with judged("options: each by itself"):
        EVERY[name](value)
        infinite = isinstance(value, float) and not math.isfinite(value)
        assert not infinite or any(word in name for word in UNDECLARED), f"{name} takes {value}"


@examples(small=60, large=600)
@given(
    number=st.one_of(st.floats(), st.integers(), st.sampled_from(HOSTILE)),
    kind=st.sampled_from([("loss", make_terms), ("augmentation", partial(make_augmentations, standard=True))]),
    node=st.sampled_from(["photometric", "depth_transfer", "smoothness", "mirror", "jitter", "nobody", ""]),
    option=st.sampled_from(["", "weight", "probability", "patch", "strength", "id", "residual"]),
)
def test_terms_and_augmentations(number: Any, kind: tuple[str, Callable], node: str, option: str) -> None:
    with judged("options: loss and augmentation"):
        made = kind[1]({node: {option: number} if option else number})
        assert made is not None


@examples(small=1, large=150)
@given(name=st.sampled_from(sorted(EVERY)), text=st.sampled_from(TEXTS), number=st.integers(0, 10**9))
def test_whole_commands(tmp_path_factory: pytest.TempPathFactory, name: str, text: str, number: int) -> None:
    option = name.replace("=", ".").replace("slam.orb_gtsam.", "slam.")
    if "=" in name and name.partition("=")[0] not in ("loss", "augmentation"):
        option = f"{name.partition('=')[0]}.{name.rpartition('.')[2]}"
    if option.startswith(("depth", "out", "resume", "debug", "viz", "task.", "pretraining", "criterion")):
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.getbasetemp())
        patch.setattr("prgbd.report.page.write_report", lambda run: None)
        said: list[str] = []
        patch.setattr("sys.stderr.write", lambda words: said.append(words) or len(words))
        small = ["slam=orb_gtsam", "task=slam", "data.frames=3", "data.width=96", "data.height=64"]
        code = main([*small, f"{option}={text}", f"out=run-{number}"])
    judged_exit("options: whole commands", code, "".join(said))
