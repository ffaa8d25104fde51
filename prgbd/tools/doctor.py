"""``python -m prgbd.tools doctor``: what is installed, what the machine has, and what is missing, in one table."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from prgbd.core.registry import KINDS, specs

GIB = 2**30
LEAST_MEMORY = 4.0  # GiB that refining a Monodepth2-sized network needs with everything around it
LEAST_DISK = 1.0  # GiB


@dataclass(frozen=True)
class Finding:
    """One line of the table.

    Attributes:
        part: The section: packages, extras, accelerators, machine, folders or plug-ins.
        name: What was looked at.
        state: ``ok``, ``note`` (works without) or ``bad``.
        text: What was found, with the mend where something is wrong.
    """

    part: str
    name: str
    state: str
    text: str


def main() -> int:
    """Print the table.

    Returns:
        The exit code: 0, or 1 if something is missing that prgbd cannot work without.
    """
    console = Console() if sys.stdout.isatty() else Console(width=160, color_system=None)
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    marks = {"ok": "[green]ok[/green]", "note": "[yellow]-[/yellow]", "bad": "[red]MEND[/red]"}
    part, bad = "", 0
    for finding in examine():
        table.add_row(
            finding.part if finding.part != part else "", finding.name, marks[finding.state], escape(finding.text)
        )
        part, bad = finding.part, bad + (finding.state == "bad")
    console.print(table)
    console.print(f"\n{bad} thing(s) to mend." if bad else "\nEverything that prgbd needs is here.")
    return 1 if bad else 0


def examine() -> Iterator[Finding]:
    """Look at everything; nothing is changed but a file that is written and removed in each folder."""
    yield from _packages()
    yield from _extras()
    yield from _accelerators()
    yield from _machine()
    yield from _folders()
    yield from _plugins()


def _packages() -> Iterator[Finding]:
    yield Finding("packages", "python", "ok", f"{platform.python_version()} on {platform.platform()}")
    try:
        requirements = metadata.requires("prgbd") or []
        yield Finding("packages", "prgbd", "ok", metadata.version("prgbd"))
    except metadata.PackageNotFoundError:
        yield Finding("packages", "prgbd", "note", "is not installed but imported from its folder; pip install -e .")
        return
    for name, wanted, extra in map(_parsed, requirements):
        if not extra:
            version = _version(name)
            fits = version is not None and _satisfies(version, wanted)
            text = version or "missing"
            yield Finding(
                "packages", name, *(("ok", text) if fits else ("bad", f"{text}; pip install '{name}{wanted}'"))
            )


def _extras() -> Iterator[Finding]:
    try:
        known = metadata.metadata("prgbd").get_all("Provides-Extra") or []
        requirements = [_parsed(line) for line in metadata.requires("prgbd") or []]
    except metadata.PackageNotFoundError:
        return
    for extra in known:
        needed = [name for name, _, of in requirements if of == extra]
        absent = [name for name in needed if _version(name) is None]
        if absent:
            yield Finding("extras", extra, "note", f"without {', '.join(absent)}; pip install 'prgbd[{extra}]'")
        else:
            yield Finding("extras", extra, "ok", ", ".join(f"{name} {_version(name)}" for name in needed))


def _accelerators() -> Iterator[Finding]:
    try:
        import torch
    except ImportError as error:
        yield Finding("accelerators", "torch", "bad", f"cannot be imported: {error}")
        return
    if torch.cuda.is_available():
        for index in range(torch.cuda.device_count()):
            properties = torch.cuda.get_device_properties(index)
            text = f"{properties.name}, {properties.total_memory / GIB:.0f} GiB; use trainer=gpu"
            yield Finding("accelerators", f"cuda:{index}", "ok", text)
    elif torch.backends.mps.is_available():
        yield Finding("accelerators", "mps", "ok", "use trainer.accelerator=mps")
    else:
        yield Finding("accelerators", "none", "note", "the network runs on the processor, which prgbd is made for too")
    yield Finding("accelerators", "torch threads", "ok", str(torch.get_num_threads()))


def _machine() -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    yield Finding("machine", "cores", "ok", f"{cores}{load}")
    memory = _memory()
    if memory is not None:
        total, free = memory
        enough = total >= LEAST_MEMORY
        text = f"{total:.1f} GiB, {free:.1f} GiB free"
        hint = "; lower training.batch_size and training.memory_mb"
        yield Finding("machine", "memory", "ok" if enough else "note", text if enough else text + hint)


def _memory() -> tuple[float, float] | None:
    """Total and free memory in GiB, within the limit of a container where there is one."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    kib = {line.partition(":")[0]: float(line.split()[1]) for line in lines}
    total, free = kib["MemTotal"] * 1024, kib.get("MemAvailable", kib["MemFree"]) * 1024
    try:
        group = Path("/sys/fs/cgroup")
        limit = float((group / "memory.max").read_text())
        used = float((group / "memory.current").read_text())
        if limit < total:
            total, free = limit, min(free, limit - used)
    except (OSError, ValueError):
        pass
    return total / GIB, free / GIB


def _folders() -> Iterator[Finding]:
    numba_cache = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parents[1])
    hub = Path(os.environ.get("HF_HOME") or Path.home() / ".cache" / "huggingface")
    for name, folder, hint in (
        ("runs (outputs)", Path.cwd(), "choose another with out=FOLDER"),
        ("compiled kernels", numba_cache, "set NUMBA_CACHE_DIR to a folder that is kept, or each start compiles anew"),
        ("downloaded models", hub, "set HF_HOME to another folder"),
        ("temporary files", Path(tempfile.gettempdir()), "set TMPDIR to another folder"),
    ):
        existing = next(p for p in (folder, *folder.parents) if p.is_dir())
        try:
            with tempfile.TemporaryFile(dir=existing):
                pass
        except OSError as error:
            yield Finding("folders", name, "note", f"{folder} cannot be written ({error.strerror}); {hint}")
            continue
        free = shutil.disk_usage(existing).free / GIB
        enough = free >= LEAST_DISK
        text = f"{folder}, {free:.1f} GiB free"
        yield Finding("folders", name, "ok" if enough else "note", text if enough else f"{text}; make room, or {hint}")


def _plugins() -> Iterator[Finding]:
    for kind in KINDS:
        found = specs(kind)
        foreign = [f"{spec.id} ({spec.origin})" for spec in found if spec.origin != "built-in"]
        text = f"{len(found) - len(foreign)} built-in" + (f", and {', '.join(foreign)}" if foreign else "")
        yield Finding("plug-ins", kind, "ok", text)


def _parsed(line: str) -> tuple[str, str, str]:
    """Split a requirement into name, version specifier and extra ("" for none)."""
    from packaging.requirements import Requirement

    requirement = Requirement(line)
    marker = str(requirement.marker or "")
    extra = marker.partition('extra == "')[2].partition('"')[0]
    return requirement.name, str(requirement.specifier), extra


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _satisfies(version: str, wanted: str) -> bool:
    from packaging.specifiers import SpecifierSet

    return SpecifierSet(wanted).contains(version, prereleases=True)
