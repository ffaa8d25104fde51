"""Make the pictures of the documentation from the report of a demo run: ``python docs/pictures.py outputs/demo``.

Needs chromium. The pictures are parts of ``report.html`` as a browser shows them.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).parent / "images"
# Name: (headings of the sections that are shown, "" for the top; further CSS; width of the window; of the picture)
PICTURES = {
    "report": (("", "Loops", "Trajectories and tracking"), "", 1160, 900),
    "report-depth": (("Depth", "Depth by range"), ".frame~.frame{display:none}", 1160, 900),
    "demo": (
        ("Trajectories and tracking", "Depth"),
        "header,.frame~.frame,.slider,.cards,.js .slider,main>h3~h3{display:none}",
        1160,
        900,
    ),
}
HIDE = """
const wanted = %s;
addEventListener("load", () => {
  let shown = wanted.includes("");
  for (const part of document.querySelector("main").children) {
    if (part.matches("h2") || part.textContent === "Depth by range") shown = wanted.includes(part.textContent);
    if (!shown) part.style.display = "none";
  }
  if (!wanted.includes("")) document.querySelector("header").style.display = "none";
  document.querySelector("footer").style.display = "none";
});
"""


def picture(report: str, name: str) -> Image.Image:
    """Return a part of the page without the empty rows at its end."""
    headings, css, width, small = PICTURES[name]
    program = next((p for p in ("chromium", "chromium-browser", "google-chrome") if shutil.which(p)), None)
    if program is None:
        sys.exit("There is no chromium; install it.")
    script = f"<style>{css}</style><script>{HIDE % list(headings)}</script>"
    with tempfile.TemporaryDirectory() as folder:
        page, shot = Path(folder) / "page.html", Path(folder) / "shot.png"
        page.write_text(report.replace("</head>", f"{script}</head>", 1), encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=4000"]
        target = [f"--screenshot={shot}", f"--window-size={width},4000", f"--user-data-dir={folder}/profile"]
        subprocess.run([program, *options, *target, page.as_uri()], check=True, capture_output=True)
        image = Image.open(shot).convert("RGB")
    filled = np.flatnonzero((np.asarray(image) != np.asarray(image)[-1, -1]).any(axis=(1, 2)))
    image = image.crop((0, max(0, int(filled[0]) - 16), width, int(filled[-1]) + 16))
    size = (small, round(image.height * small / width))
    return image.resize(size, Image.Resampling.LANCZOS).quantize(256, dither=Image.Dither.NONE)


def main() -> None:
    """Make all pictures."""
    parser = argparse.ArgumentParser(description="Make the pictures of the documentation from a demo run.")
    parser.add_argument("run", type=Path, help="folder of the run")
    report = (parser.parse_args().run / "report.html").read_text(encoding="utf-8")
    for name in PICTURES:
        path = HERE / f"{name}.png"
        picture(report, name).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
