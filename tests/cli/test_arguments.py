import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from prgbd.cli.arguments import is_multirun, normalise, value_of
from prgbd.core.errors import ConfigError


def test_groups_with_and_without_plus_are_the_same():
    given = ["+slam=orb_gtsam", "depth=monodepth2", "++data=images", "+task=slam", "-m"]
    assert normalise(given) == ["slam=orb_gtsam", "depth=monodepth2", "data=images", "task=slam", "-m"]


def test_options_of_plugins_are_passed_on_whatever_their_name():
    assert normalise(["slam.x=1", "+depth.weights=w", "++data.root=r"]) == [
        "++slam.x=1",
        "++depth.weights=w",
        "++data.root=r",
    ]


def test_other_options_and_flags_with_values_stay_as_they_are():
    given = ["seed=3", "~slam", "--cfg", "job", "-cd", "my/conf", "data.sequences=[00,01]"]
    assert normalise(given) == [*given[:-1], "++data.sequences=[00,01]"]


@pytest.mark.parametrize("nonsense", ["foo", "=3", "3=4", "a b=1", "--no-such-flag", "+slam"])
def test_nonsense_is_refused_in_one_sentence_that_names_it(nonsense):
    with pytest.raises(ConfigError) as error:
        normalise([nonsense])
    assert nonsense in str(error.value)
    assert "\n" not in str(error.value)


def test_the_last_value_of_an_option_counts():
    assert value_of(["seed=1", "+seed=2", "seeds=3"], "seed") == "2"
    assert value_of(["seed=1"], "resume") is None
    assert is_multirun(["--multirun"])
    assert not is_multirun(["x=-m"])


@pytest.mark.parametrize("name", ["my video (1).mp4", "it's, mine.mp4", "ümläut.mp4"])
def test_a_file_that_is_there_needs_no_quotes(tmp_path, name):
    film = tmp_path / name
    film.touch()
    assert normalise([f"data.root={film}"]) == ["++data.root='" + str(film).replace("'", r"\'") + "'"]
    assert normalise([f"data.name={film}.x", f"data.root='{film}'"]) == [
        f"++data.name={film}.x",
        f"++data.root='{film}'",
    ]
    absent = f"{film}.x"
    assert normalise([f"data.root={absent}"]) == [
        f"++data.root={absent}" if "'" in absent else f"++data.root='{absent}'"
    ]
    (override,) = OverridesParser.create().parse_overrides(normalise([f"data.root={film}"]))
    assert override.value() == str(film)
