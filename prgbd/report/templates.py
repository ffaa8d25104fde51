"""The Jinja templates of the report: HTML with every value escaped, LaTeX and Markdown with filters of their own."""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from prgbd.report.pictures import gradient, jpeg_address
from prgbd.report.words import number, percent

# fmt: off
_LATEX = str.maketrans({
    "\\": r"\textbackslash{}", "δ": r"$\delta$", "²": "$^2$", "³": "$^3$", "→": r"$\to$", "±": r"$\pm$", "–": "--",
    "−": "$-$", "°": r"$^\circ$", "<": "$<$", ">": "$>$", "^": r"\^{}", "~": r"\~{}",
    **{c: "\\" + c for c in "&%$#_{}"},
})
# fmt: on


def render(name: str, **context: Any) -> str:
    """Return the template ``name`` filled with ``context``; an undefined name is an error."""
    return _environment().get_template(name).render(context)


@cache
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader("prgbd.report"),
        autoescape=select_autoescape(["html"], default=False),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    found.globals["static"] = static
    filters = {"number": number, "percent": percent, "size": size, "jpeg": jpeg_address, "gradient": gradient}
    found.filters |= filters | {"tex": latex, "cell": markdown_cell}
    return found


def static(name: str) -> Markup:
    """Return a style sheet or script of the page as it is."""
    return Markup((resources.files("prgbd.report") / "static" / name).read_text(encoding="utf-8"))


def latex(text: str) -> str:
    """Return a text as LaTeX reads it."""
    return text.translate(_LATEX)


def markdown_cell(text: str) -> str:
    """Return a text that does not end its cell of a Markdown table."""
    return text.replace("|", "\\|")


def size(count: int) -> str:
    """Return a number of bytes in words."""
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{max(1, round(count / 1e3))} kB"
