"""The page in a real browser: its interactive parts answer, it fits a phone, and it prints."""

import pytest

from prgbd.report.page import render
from prgbd.report.reading import open_run
from tests.report.browser import browser, driven

DRIVE = """
function ink(canvas) {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let sum = 0, painted = 0;
  for (let i = 0; i < data.length; i += 4) if (data[i + 3]) { painted++; sum = (sum * 31 + i + data[i]) % 1000003; }
  return [painted, sum];
}
function drag(canvas, dx, dy) {
  const at = (kind, x, y) => canvas.dispatchEvent(
    new PointerEvent(kind, { pointerId: 7, clientX: x, clientY: y, buttons: 1, bubbles: true }));
  at("pointerdown", 100, 100);
  at("pointermove", 100 + dx, 100 + dy);
  at("pointerup", 100 + dx, 100 + dy);
}
function drive() {
  const box = document.querySelector(".view3d"), canvas = box.querySelector("canvas");
  const found = { scroll: document.documentElement.scrollWidth, window: window.innerWidth, top: ink(canvas) };
  box.querySelector('[data-view="3d"]').click();
  found.threeD = ink(canvas);
  drag(canvas, 60, 20);
  found.turned = ink(canvas);
  found.yaw = box.view.yaw;
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "+" }));
  found.zoom = box.view.zoom;
  found.zoomed = ink(canvas);
  box.querySelector('[data-show="points"]').click();
  found.bare = ink(canvas);
  for (const toggle of box.querySelectorAll("input:checked")) toggle.click();
  found.empty = ink(canvas);
  const slider = document.querySelector(".slider"), range = slider.querySelector("input");
  const over = slider.querySelector(".over");
  found.clip = getComputedStyle(over).clipPath;
  range.value = 20;
  range.dispatchEvent(new Event("input"));
  found.moved = getComputedStyle(over).clipPath;
  found.buttons = [...slider.querySelectorAll("button")].map((b) => b.textContent);
  const before = over.src;
  slider.querySelectorAll("button")[1].click();
  found.changed = over.src !== before;
  found.sliders = document.querySelectorAll(".slider").length;
  found.fallback = getComputedStyle(document.querySelector(".static")).display;
  return found;
}
"""


@pytest.fixture(scope="module")
def html(run_folder):
    return render(open_run(run_folder))


def test_the_interactive_parts_answer_on_a_phone(html, tmp_path):
    found = driven(html, DRIVE, 390, tmp_path)
    assert found["errors"] == []
    assert found["window"] == 390
    assert found["scroll"] <= 390
    views = [tuple(found[key]) for key in ("top", "threeD", "turned", "zoomed", "bare", "empty")]
    assert len(set(views)) == len(views)
    assert found["yaw"] == pytest.approx(0.6 + 60 * 0.008)
    assert found["zoom"] == pytest.approx(0.9 * 1.2)
    painted = [view[0] for view in views]
    assert painted[3] > painted[4] > painted[5] > 0  # map points, then paths alone, then the ruler alone
    assert "20%" not in found["clip"]
    assert found["moved"] != found["clip"]
    assert found["buttons"][:2] == ["Depth before | after", "Error before | after"]
    assert found["changed"]
    assert found["sliders"] == 3
    assert found["fallback"] == "none"


def test_the_page_prints(html, tmp_path):
    page, pdf = tmp_path / "report.html", tmp_path / "report.pdf"
    page.write_text(html, encoding="utf-8")
    browser(f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri(), folder=tmp_path)
    data = pdf.read_bytes()
    assert data.startswith(b"%PDF")
    assert data.count(b"/Type /Page\n") + data.count(b"/Type /Page ") >= 2
