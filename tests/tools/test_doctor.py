"""``python -m prgbd.tools doctor``."""

from __future__ import annotations

from importlib import metadata

import pytest

from prgbd.tools import doctor


def findings() -> dict[tuple[str, str], doctor.Finding]:
    return {(f.part, f.name): f for f in doctor.examine()}


def test_a_sound_installation_has_nothing_to_mend(capsys) -> None:
    assert doctor.main() == 0
    out = capsys.readouterr().out
    assert "Everything that prgbd needs is here." in out
    assert metadata.version("torch") in out
    found = findings()
    assert found["machine", "cores"].state == "ok"
    assert "built-in" in found["plug-ins", "depth"].text


def test_a_missing_and_an_old_package_are_to_mend_and_a_missing_extra_is_noted(monkeypatch, capsys) -> None:
    known = metadata.version

    def version(name: str) -> str:
        if name in ("evo", "tensorboard"):
            raise metadata.PackageNotFoundError(name)
        return "1.0" if name == "numpy" else known(name)

    monkeypatch.setattr(metadata, "version", version)
    found = findings()
    assert found["packages", "evo"].state == "bad"
    assert "pip install 'evo" in found["packages", "evo"].text
    assert found["packages", "numpy"].state == "bad"
    assert found["extras", "tensorboard"].state == "note"
    assert doctor.main() == 1
    assert "2 thing(s) to mend" in capsys.readouterr().out


def test_a_folder_that_cannot_be_written_is_named_with_its_mend(monkeypatch) -> None:
    def refuse(**options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    found = findings()["folders", "compiled kernels"]
    assert found.state == "note"
    assert "NUMBA_CACHE_DIR" in found.text


@pytest.mark.parametrize(
    ("line", "parsed"),
    [
        ("torch>=2.6", ("torch", ">=2.6", "")),
        ('build>=1.2; extra == "dev"', ("build", ">=1.2", "dev")),
        ('x ; python_version < "3.12" and extra == "a-b"', ("x", "", "a-b")),
    ],
)
def test_requirements_are_read_with_their_extra(line, parsed) -> None:
    assert doctor._parsed(line) == parsed
