"""Names of recordings."""

from __future__ import annotations

import unicodedata

import pytest

from prgbd.io.naming import MOST_BYTES, safe_name


@pytest.mark.parametrize("name", ["redkitchen_seq-01", "办公室", "é", "हिन्दी", "IMG.01", "20240101-120000"])
def test_letters_and_digits_of_every_script_are_kept(name: str) -> None:
    assert safe_name(name) == name


def test_two_texts_never_get_one_name() -> None:
    texts = [
        "my walk",
        "my_walk",
        "my  walk",
        "my/walk",
        " my walk",
        "",
        "///",
        "..",
        ".my_walk",
        "-my_walk",
        "a" * 300,
    ]
    texts += ["a" * 301, "con", "CON.txt", unicodedata.normalize("NFD", "é"), "é", safe_name("my walk"), "\udcff", "\0"]
    names = [safe_name(text) for text in texts]
    assert len(set(names)) == len(texts)
    for name in names:
        assert name
        assert name[0] not in ".-"
        assert not set(name) & set(' /\\:*?"<>|\0')
        assert len(name.encode()) <= MOST_BYTES + 10
