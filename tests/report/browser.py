"""Headless chromium for tests: it runs a page and a script that drives it, and returns what the script found."""

import json
import re
import shutil
import subprocess
from html import escape, unescape
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 300  # seconds; a busy machine starts a browser slowly

DRIVER = """
const errors = [];
window.addEventListener("error", (e) => errors.push(String(e.message)));
window.addEventListener("unhandledrejection", (e) => errors.push(String(e.reason)));
console.error = (...words) => errors.push(words.join(" "));
window.addEventListener("load", () => setTimeout(() => {
  let found = {};
  try { found = drive(); } catch (e) { errors.push(String(e.stack || e)); }
  parent.document.getElementById("found").textContent = JSON.stringify({ ...found, errors });
}, 50));
"""


def browser(*arguments: str, folder: Path) -> str:
    """Run the browser and return what it prints; skips where there is none or it does not run."""
    program = next((name for name in BROWSERS if shutil.which(name)), None)
    if program is None:
        pytest.skip("no headless browser (chromium) is installed")
    command = [program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", *arguments]
    try:
        done = subprocess.run(
            [*command, f"--user-data-dir={folder / 'profile'}"],
            capture_output=True,
            timeout=PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        pytest.skip(f"{program} did not answer in {PATIENCE} s on this machine")
    if done.returncode:
        pytest.skip(f"{program} does not run here: {done.stderr.decode()[-200:]}")
    return done.stdout.decode()


def driven(html: str, script: str, width: int, folder: Path) -> dict:
    """Open a page in a frame of ``width`` pixels, run ``script`` (which defines ``drive()``) and return its answer."""
    inside = html.replace("<head>", f"<head><script>{DRIVER}{script}</script>", 1)
    frame = f'<iframe style="width:{width}px;height:900px;border:0" srcdoc="{escape(inside, quote=True)}"></iframe>'
    page = folder / f"driven-{width}.html"
    page.write_text(f'<!doctype html><meta charset="utf-8"><pre id="found"></pre>{frame}', encoding="utf-8")
    dom = browser("--virtual-time-budget=4000", "--dump-dom", page.as_uri(), folder=folder)
    match = re.search(r'<pre id="found">(.*?)</pre>', dom, re.DOTALL)
    assert match, dom[:500]
    assert match[1], "the page's script did not come to its end"
    return json.loads(unescape(match[1]))
