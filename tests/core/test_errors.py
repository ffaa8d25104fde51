from prgbd.core.errors import ConfigError, DataError


def test_a_long_word_of_the_input_is_kept_short():
    text = str(DataError(f"There is no {'a' * 3000}.png; name a file that exists."))
    assert len(text) < 170
    assert text.startswith("There is no aaa")
    assert text.endswith("aaa.png; name a file that exists.")


def test_words_that_people_read_stay_as_they_are():
    path = "/home/somebody/" + "recordings/" * 15
    assert str(ConfigError(f"{path} is empty; name another.")) == f"{path} is empty; name another."
