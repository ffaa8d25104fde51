"""Text files of the user's, whatever wrote them."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from prgbd.io.files import read_json
from prgbd.io.reading import decode, read_text
from tests.robustness.fuzzing import examples, judged

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-32")


@examples(small=50, large=300)
@given(data=st.binary(max_size=200))
def test_any_bytes_are_text_or_refused(data):
    Path("file.txt").write_bytes(data)
    with judged("text files"):
        assert isinstance(read_text("file.txt", "list"), str)
    with judged("JSON files"):
        read_json("file.txt")


@examples(small=50, large=100)
@given(
    text=st.text(st.characters(exclude_categories=("Cs", "Cc"), exclude_characters="\ufeff")),
    encoding=st.sampled_from(ENCODINGS),
)
def test_text_survives_its_encoding(text, encoding):
    assert decode(text.encode(encoding)) == text
