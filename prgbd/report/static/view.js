/* Trajectories and map: seen from above or turned freely, on a plain canvas. Mouse, touch and keys.
   The data lie in the element's <script type="application/json"> (prgbd/report/interactive.py writes them). */
"use strict";

function unpack(text, Kind) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Kind(bytes.buffer);
}

class TrajectoryView {
  constructor(box) {
    this.box = box;
    this.canvas = box.querySelector("canvas");
    this.scene = JSON.parse(box.querySelector("script").textContent);
    for (const cloud of this.scene.clouds) {
      cloud.xyz = unpack(cloud.xyz, Int16Array);
      cloud.rgb = unpack(cloud.rgb, Uint8Array);
    }
    this.shown = {};
    for (const toggle of box.querySelectorAll("input[data-show]")) {
      this.shown[toggle.dataset.show] = toggle.checked;
      toggle.addEventListener("change", () => {
        this.shown[toggle.dataset.show] = toggle.checked;
        this.draw();
      });
    }
    for (const button of box.querySelectorAll("button[data-view]"))
      button.addEventListener("click", () => this.look(button.dataset.view));
    this.pointers = new Map();
    this.listen();
    this.look("top");
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  look(view) {
    this.view = view;
    this.yaw = view === "top" ? 0 : 0.6;
    this.pitch = view === "top" ? Math.PI / 2 : 0.55;
    this.zoom = view === "top" ? 1 : 0.9;
    this.pan = [0, 0];
    for (const button of this.box.querySelectorAll("button[data-view]"))
      button.setAttribute("aria-pressed", String(button.dataset.view === view));
    this.draw();
  }

  listen() {
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (e) => {
      if (e.isTrusted) canvas.setPointerCapture(e.pointerId);
      this.pointers.set(e.pointerId, [e.clientX, e.clientY]);
    });
    canvas.addEventListener("pointermove", (e) => this.move(e));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"])
      canvas.addEventListener(end, (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("dblclick", () => this.look(this.view));
    // The page scrolls over the picture until it was clicked.
    canvas.addEventListener("wheel", (e) => {
      if (document.activeElement !== canvas && !e.ctrlKey) return;
      e.preventDefault();
      this.scaleBy(Math.exp(-0.0015 * e.deltaY));
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => this.key(e));
  }

  move(e) {
    const before = this.pointers.get(e.pointerId);
    if (!before) return;
    const spread = this.spread();
    this.pointers.set(e.pointerId, [e.clientX, e.clientY]);
    const dx = e.clientX - before[0], dy = e.clientY - before[1];
    if (this.pointers.size > 1) {
      if (spread > 0) this.zoom = this.limited(this.zoom * this.spread() / spread);
      this.pan[0] += dx / this.pointers.size;
      this.pan[1] += dy / this.pointers.size;
    } else if (this.view === "top" || e.shiftKey || e.buttons === 2) {
      this.pan[0] += dx;
      this.pan[1] += dy;
    } else this.turn(dx * 0.008, dy * 0.008);
    this.draw();
  }

  spread() {
    const [a, b] = [...this.pointers.values()];
    return b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 0;
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(Math.PI / 2, Math.max(-0.3, this.pitch + pitch));
  }

  limited(zoom) {
    return Math.min(80, Math.max(0.02, zoom));
  }

  scaleBy(factor) {
    this.zoom = this.limited(this.zoom * factor);
    this.pan = this.pan.map((p) => p * factor);
    this.draw();
  }

  key(e) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (steps[e.key]) {
      const [x, y] = steps[e.key];
      if (this.view === "top") this.pan = [this.pan[0] - 20 * x, this.pan[1] - 20 * y];
      else this.turn(0.1 * x, 0.1 * y);
    } else if (e.key === "+" || e.key === "=") this.zoom = this.limited(this.zoom * 1.2);
    else if (e.key === "-") this.zoom = this.limited(this.zoom / 1.2);
    else return;
    e.preventDefault();
    this.draw();
  }

  /* From the scene (x right, y away, z up; metres around its middle) to pixels of the canvas. */
  projection(width, height) {
    const scale = this.zoom * Math.min(width / this.scene.size[0], height / this.scene.size[1]);
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    const mx = width / 2 + this.pan[0], my = height / 2 + this.pan[1];
    return (x, y, z) => {
      const away = sy * x + cy * y;
      return [mx + scale * (cy * x - sy * y), my - scale * (sp * away + cp * z)];
    };
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (!width) return;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const style = getComputedStyle(this.box);
    const at = this.projection(width, height);
    for (const cloud of this.scene.clouds) if (this.shown.points && this.shown[cloud.of]) this.drawCloud(pen, cloud, at);
    for (const path of this.scene.paths) if (this.shown[path.name]) this.drawPath(pen, path, at, style);
    this.drawRuler(pen, width, height, style);
  }

  drawCloud(pen, cloud, at) {
    const { xyz, rgb, unit } = cloud;
    pen.globalAlpha = 0.75;
    for (let i = 0; i < xyz.length; i += 3) {
      const [u, v] = at(xyz[i] * unit, xyz[i + 1] * unit, xyz[i + 2] * unit);
      pen.fillStyle = `rgb(${rgb[i]},${rgb[i + 1]},${rgb[i + 2]})`;
      pen.fillRect(u, v, 1.6, 1.6);
    }
    pen.globalAlpha = 1;
  }

  drawPath(pen, path, at, style) {
    pen.strokeStyle = path.colour || style.getPropertyValue("--ink");
    pen.lineWidth = path.colour ? 2.2 : 1.6;
    pen.setLineDash(path.colour ? [] : [6, 4]);
    pen.lineJoin = "round";
    pen.beginPath();
    let down = false;
    for (const point of path.xyz) {
      if (point === null) { down = false; continue; }
      const [u, v] = at(...point);
      if (down) pen.lineTo(u, v); else pen.moveTo(u, v);
      down = true;
    }
    pen.stroke();
    pen.setLineDash([]);
    if (path.xyz.length) {
      const [u, v] = at(...path.xyz[0]);
      pen.beginPath();
      pen.arc(u, v, 4.5, 0, 2 * Math.PI);
      pen.stroke();
    }
  }

  drawRuler(pen, width, height, style) {
    const scale = this.zoom * Math.min(width / this.scene.size[0], height / this.scene.size[1]);
    const rough = 90 / scale, power = 10 ** Math.floor(Math.log10(rough));
    const length = power * [1, 2, 5, 10].filter((f) => f * power <= rough).pop();
    pen.strokeStyle = pen.fillStyle = style.getPropertyValue("--muted");
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(12, height - 18); pen.lineTo(12, height - 12);
    pen.lineTo(12 + length * scale, height - 12); pen.lineTo(12 + length * scale, height - 18);
    pen.stroke();
    pen.font = "12px " + style.getPropertyValue("--sans");
    pen.fillText(`${Number(length.toPrecision(2))} ${this.scene.unit}`, 16, height - 18);
  }
}

document.documentElement.classList.add("js");
document.addEventListener("DOMContentLoaded", () => {
  for (const box of document.querySelectorAll(".view3d")) box.view = new TrajectoryView(box);
});
