/* Two pictures over each other with a line to drag, made from the pictures that are on the page anyway. */
"use strict";

class Slider {
  constructor(frame) {
    const tile = (role) => frame.querySelector(`[data-role="${role}"]`);
    this.pairs = JSON.parse(frame.dataset.pairs).filter(([, a, b]) => tile(a) && tile(b));
    if (!this.pairs.length) return;
    this.tile = tile;
    this.box = document.createElement("div");
    this.box.className = "slider";
    this.box.innerHTML =
      '<div class="stage"><img alt=""><img alt="" class="over"><i></i><span></span><span></span>' +
      '<input type="range" min="0" max="100" value="50" step="0.5" aria-label="line between the two pictures"></div>';
    [this.under, this.over] = this.box.querySelectorAll("img");
    [this.left, this.right] = this.box.querySelectorAll("span");
    this.range = this.box.querySelector("input");
    this.range.addEventListener("input", () => this.divide());
    if (this.pairs.length > 1) this.box.prepend(this.choices());
    frame.prepend(this.box);
    this.show(this.pairs[0]);
    this.divide();
  }

  choices() {
    const row = document.createElement("div");
    row.className = "choices";
    for (const pair of this.pairs) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = pair[0];
      button.addEventListener("click", () => this.show(pair));
      row.append(button);
    }
    return row;
  }

  show(pair) {
    const [before, after] = [this.tile(pair[1]), this.tile(pair[2])];
    [this.under.src, this.over.src] = [after.src, before.src];
    [this.under.alt, this.over.alt] = [after.alt, before.alt];
    [this.left.textContent, this.right.textContent] = [before.alt, after.alt];
    for (const button of this.box.querySelectorAll("button"))
      button.setAttribute("aria-pressed", String(button.textContent === pair[0]));
  }

  divide() {
    this.box.style.setProperty("--at", this.range.value + "%");
  }
}

document.addEventListener("DOMContentLoaded", () => {
  for (const frame of document.querySelectorAll(".frame[data-pairs]")) frame.slider = new Slider(frame);
});
