"""Painting of the textures: each function draws one kind of surface with a random generator."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Image = NDArray[np.float32]
Colour = Sequence[float] | NDArray[np.float64]


def noise(rng: Generator, size: int, cells: int, octaves: int = 5, persistence: float = 0.6) -> Image:
    """Return (size, size) noise that tiles, of zero mean and unit deviation, with features of size/cells and finer."""
    total = np.zeros((size, size), np.float32)
    gain = 1.0
    for _ in range(octaves):
        if cells > size:
            break
        grid = np.pad(rng.standard_normal((cells, cells)).astype(np.float32), 2, mode="wrap")
        step = size // cells
        wide = cv2.resize(grid, None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)
        total += gain * wide[2 * step : 2 * step + size, 2 * step : 2 * step + size]
        cells, gain = cells * 2, gain * persistence
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def flat(size: int, colour: Colour) -> Image:
    """Return an image of one colour."""
    return np.broadcast_to(np.asarray(colour, np.float32), (size, size, 3)).copy()


def colour(rng: Generator, low: float = 60, high: float = 220, saturation: float = 0.35) -> NDArray[np.float64]:
    """Return a random colour of moderate saturation."""
    grey = rng.uniform(low, high)
    return np.clip(grey * (1 + 0.6 * saturation * rng.uniform(-1, 1, 3)), 10, 245)


def _rectangle(image: Image, x0: float, y0: float, x1: float, y1: float, value: Colour) -> None:
    image[max(0, round(y0)) : max(0, round(y1)), max(0, round(x0)) : max(0, round(x1))] = np.asarray(value, np.float32)


def rough(rng: Generator, size: int, base: Colour, contrast: float, cells: int = 8, octaves: int = 6) -> Image:
    """Plain rough matter: plaster, soil, bark, leaves, cloth."""
    return flat(size, base) + contrast * noise(rng, size, cells, octaves, 0.75)[..., None]


def asphalt(rng: Generator, size: int) -> Image:
    """Asphalt with patches, tar seams, cracks and stains."""
    image = flat(size, [rng.uniform(80, 110)] * 3)
    for _ in range(14):
        x, y, w, h = (*rng.uniform(0, size, 2), *rng.uniform(0.03, 0.22, 2) * size)
        _rectangle(image, x, y, x + w, y + h, [rng.uniform(58, 125)] * 3)
    for _ in range(18):
        steps = rng.normal(0, size / 45, (24, 2)) + rng.normal(0, size / 60, 2)
        points = (rng.uniform(0, size, 2) + np.cumsum(steps, axis=0)).astype(np.int32)
        cv2.polylines(image, [points], False, [float(rng.uniform(25, 50))] * 3, int(rng.integers(1, 4)))
    for _ in range(50):
        centre = tuple(int(v) for v in rng.uniform(0, size, 2))
        cv2.circle(image, centre, int(rng.integers(2, size // 50)), [float(rng.uniform(40, 150))] * 3, -1)
    return image + 11 * noise(rng, size, 16, 6, 0.9)[..., None]


def paving(rng: Generator, size: int, across: int, along: int) -> Image:
    """Slabs of differing brightness with dark joints, some stained."""
    image = np.zeros((size, size, 3), np.float32)
    base = colour(rng, 110, 170, 0.1)
    dx, dy = size / across, size / along
    for j in range(along):
        for i in range(across):
            shade = base * rng.uniform(0.65, 1.25)
            _rectangle(image, i * dx + 1, j * dy + 1, (i + 1) * dx, (j + 1) * dy, shade)
    return image + 9 * noise(rng, size, 8, 6, 0.8)[..., None]


def bricks(rng: Generator, size: int, courses: int) -> Image:
    """Bricks in running bond."""
    base, mortar = colour(rng, 80, 160, 0.3), colour(rng, 120, 190, 0.05)
    image = flat(size, mortar)
    height = size / courses
    width = height * 2.6
    columns = max(2, round(size / width))
    width = size / columns
    for j in range(courses):
        for i in range(-1, columns + 1):
            x = (i + 0.5 * (j % 2)) * width
            _rectangle(image, x + 1, j * height + 1, x + width, (j + 1) * height, base * rng.uniform(0.6, 1.3))
    return image + 8 * noise(rng, size, 4, 6, 0.8)[..., None]


def _lettering(rng: Generator, image: Image, x: float, y: float, width: float, height: float) -> None:
    """Write a word of made-up letters (random 3x5 glyphs) into a box; no font, so no version of one, is involved."""
    letters = int(rng.integers(3, 8))
    ink = colour(rng, 10, 250, 0.5)
    dx, dy = width / (4 * letters), height / 5
    for letter in range(letters):
        glyph = rng.random((5, 3)) < 0.6
        for j, i in np.argwhere(glyph):
            left, top = x + (4 * letter + i) * dx, y + j * dy
            _rectangle(image, left, top, left + dx, top + dy, ink)


def _window(rng: Generator, image: Image, x: float, y: float, w: float, h: float, frame: NDArray[np.float64]) -> None:
    """Draw one window: frame, glass with a reflection, curtain or blind, sill."""
    _rectangle(image, x, y, x + w, y + h, frame)
    border = max(2.0, 0.07 * w)
    gx0, gy0, gx1, gy1 = x + border, y + border, x + w - border, y + h - border
    glass = rng.uniform(20, 90)
    _rectangle(image, gx0, gy0, gx1, gy1, [glass, glass * 1.05, glass * 1.15])
    kind = rng.integers(0, 4)
    if kind == 0:
        part = rng.uniform(0.2, 0.8)
        _rectangle(image, gx0, gy0, gx1, gy0 + part * (gy1 - gy0), colour(rng, 120, 220, 0.15))
    elif kind == 1:
        part = rng.uniform(0.1, 0.35) * (gx1 - gx0)
        curtain = colour(rng, 120, 230, 0.3)
        _rectangle(image, gx0, gy0, gx0 + part, gy1, curtain)
        _rectangle(image, gx1 - part, gy0, gx1, gy1, curtain)
    elif kind == 2:
        cx, cy, r = rng.uniform(gx0, gx1), rng.uniform(gy0 + h / 2, gy1), 0.15 * w
        _rectangle(image, cx - r, cy - r, min(cx + r, gx1), gy1, colour(rng, 60, 200, 0.5))
    if rng.random() < 0.7:
        _rectangle(image, x + w / 2 - border / 3, gy0, x + w / 2 + border / 3, gy1, frame)
    if rng.random() < 0.5:
        bar = gy0 + rng.uniform(0.25, 0.5) * (gy1 - gy0)
        _rectangle(image, gx0, bar - border / 3, gx1, bar + border / 3, frame)
    _rectangle(image, x - border, y + h, x + w + border, y + h + border, frame * 0.75)


def facade(rng: Generator, size: int) -> Image:
    """A whole house front: wall, rows of windows, cornices, and a ground floor of doors or shops."""
    kind = rng.integers(0, 3)
    if kind == 0:
        image = bricks(rng, size, int(rng.choice([32, 40, 52])))
    elif kind == 1:
        image = rough(rng, size, colour(rng, 90, 210, 0.25), 11, 4)
    else:
        image = paving(rng, size, int(rng.integers(6, 12)), int(rng.integers(8, 16)))
    floors, columns = int(rng.integers(3, 6)), int(rng.integers(3, 7))
    height, width = size / floors, size / columns
    w, h = rng.uniform(0.4, 0.68) * width, rng.uniform(0.45, 0.68) * height
    frame = colour(rng, 40, 250, 0.1)
    trim = colour(rng, 60, 230, 0.2)
    for floor in range(floors - 1):
        y = (floor + 0.2) * height
        if rng.random() < 0.6:
            _rectangle(image, 0, floor * height, size, floor * height + 0.05 * height, trim)
        for column in range(columns):
            x = (column + 0.5) * width - w / 2
            _window(rng, image, x, y, w, h, frame)
            if rng.random() < 0.12:
                _rectangle(image, x - 3, y + 0.7 * h, x + w + 3, y + h + 4, colour(rng, 30, 120, 0.3))
    _ground_floor(rng, image, columns, (floors - 1) * height, width, height, frame)
    return image + 4 * noise(rng, size, 64, 3, 0.9)[..., None]


def _ground_floor(
    rng: Generator, image: Image, columns: int, top: float, width: float, height: float, frame: NDArray[np.float64]
) -> None:
    size = image.shape[0]
    if rng.random() < 0.7:
        _rectangle(image, 0, top, size, size, colour(rng, 50, 200, 0.4))
        sign = colour(rng, 20, 240, 0.6)
        _rectangle(image, 0.02 * size, top + 0.06 * height, 0.98 * size, top + 0.26 * height, sign)
        for part in range(2):
            _lettering(rng, image, (0.06 + 0.5 * part) * size, top + 0.1 * height, 0.36 * size, 0.12 * height)
    for column in range(columns):
        x, w = (column + 0.12) * width, 0.76 * width
        if rng.random() < 0.3:
            door = colour(rng, 30, 180, 0.5)
            _rectangle(image, x + 0.15 * w, top + 0.32 * height, x + 0.85 * w, size, frame)
            _rectangle(image, x + 0.22 * w, top + 0.36 * height, x + 0.78 * w, size, door)
            _rectangle(image, x + 0.3 * w, top + 0.42 * height, x + 0.7 * w, top + 0.6 * height, door * 0.5)
        else:
            _window(rng, image, x, top + 0.34 * height, w, 0.5 * height, frame)


def poster(rng: Generator, size: int) -> Image:
    """A poster, picture or sign: blocks, discs, lines and words of strong contrast."""
    image = flat(size, colour(rng, 30, 240, 0.5))
    for _ in range(int(rng.integers(4, 10))):
        x, y, w, h = (*rng.uniform(0, size, 2), *rng.uniform(0.1, 0.5, 2) * size)
        ink = [float(v) for v in colour(rng, 15, 245, 0.6)]
        if rng.random() < 0.5:
            _rectangle(image, x, y, x + w, y + h, ink)
        else:
            cv2.circle(image, (int(x), int(y)), int(w / 2), ink, -1)
    for line in range(int(rng.integers(1, 4))):
        height = rng.uniform(0.08, 0.2) * size
        _lettering(rng, image, 0.06 * size, (0.1 + 0.28 * line) * size, 0.85 * size, height)
    border = round(0.03 * size)
    image[:border] = image[-border:] = image[:, :border] = image[:, -border:] = colour(rng, 10, 250, 0.2)
    return image + 3 * noise(rng, size, 32, 3, 0.9)[..., None]


def car_side(rng: Generator, size: int) -> Image:
    """The side of a car below the windows: white where paint goes, doors, handles and wheels."""
    image = flat(size, [225, 225, 225]) + 5 * noise(rng, size, 8, 4)[..., None]
    for x in (0.04, 0.36, 0.66, 0.95):
        _rectangle(image, x * size, 0.05 * size, (x + 0.008) * size, 0.8 * size, [70, 70, 70])
    for x in (0.52, 0.82):
        _rectangle(image, x * size, 0.22 * size, (x + 0.06) * size, 0.28 * size, [40, 40, 40])
    _rectangle(image, 0, 0.5 * size, size, 0.53 * size, [120, 120, 120])
    _rectangle(image, 0, 0.8 * size, size, size, [35, 35, 35])
    for x in (0.19, 0.8):
        axes = (int(0.085 * size), int(0.33 * size))
        centre = (int(x * size), int(0.72 * size))
        cv2.ellipse(image, centre, axes, 0, 0, 360, [25.0] * 3, -1)
        cv2.ellipse(image, centre, (axes[0] * 6 // 10, axes[1] * 6 // 10), 0, 0, 360, [170.0] * 3, -1)
        for angle in range(0, 360, 72):
            tip = np.array(centre) + 0.55 * np.array(axes) * [np.cos(np.radians(angle)), np.sin(np.radians(angle))]
            cv2.line(image, centre, (int(tip[0]), int(tip[1])), [60.0] * 3, 2)
    return image


def car_end(rng: Generator, size: int) -> Image:
    """The front or rear of a car below the windows: lamps, number plate, grille."""
    image = flat(size, [220, 220, 220]) + 5 * noise(rng, size, 8, 4)[..., None]
    for x in (0.04, 0.74):
        _rectangle(image, x * size, 0.2 * size, (x + 0.22) * size, 0.45 * size, colour(rng, 60, 250, 0.6))
        _rectangle(image, (x + 0.08) * size, 0.26 * size, (x + 0.14) * size, 0.4 * size, [245, 240, 230])
    _rectangle(image, 0.32 * size, 0.25 * size, 0.68 * size, 0.42 * size, [45, 45, 45])
    _rectangle(image, 0.34 * size, 0.5 * size, 0.66 * size, 0.66 * size, [240, 240, 220])
    _lettering(rng, image, 0.36 * size, 0.53 * size, 0.28 * size, 0.1 * size)
    _rectangle(image, 0, 0.8 * size, size, size, [40, 40, 40])
    return image


def car_glass(rng: Generator, size: int) -> Image:
    """The windows of a car: dark glass with pillars and reflections."""
    image = flat(size, [45, 52, 60]) + 14 * noise(rng, size, 2, 3)[..., None]
    for x in (0.0, 0.3, 0.62, 0.94):
        _rectangle(image, x * size, 0, (x + 0.06) * size, size, [190, 190, 190])
    _rectangle(image, 0, 0, size, 0.12 * size, [190, 190, 190])
    for _ in range(5):
        x, y = rng.uniform(0.1, 0.9, 2) * size
        _rectangle(image, x, y, x + 0.08 * size, y + 0.1 * size, [rng.uniform(90, 170)] * 3)
    return image


def books(rng: Generator, size: int, shelves: int) -> Image:
    """Shelves of books and things."""
    image = flat(size, [45, 38, 32])
    height = size / shelves
    board = colour(rng, 70, 160, 0.2)
    for shelf in range(shelves):
        bottom = (shelf + 1) * height - 0.06 * height
        x = rng.uniform(0, 8)
        while x < size - 8:
            w, h = rng.uniform(0.02, 0.07) * size, rng.uniform(0.5, 0.88) * height
            if rng.random() < 0.88:
                spine = colour(rng, 30, 230, 0.6)
                _rectangle(image, x, bottom - h, x + w - 1, bottom, spine)
                y = bottom - rng.uniform(0.3, 0.9) * h
                _rectangle(image, x + 2, y, x + w - 3, y + 0.12 * h, colour(rng, 20, 250, 0.4))
            x += w
        _rectangle(image, 0, bottom, size, bottom + 0.06 * height, board)
    return image + 3 * noise(rng, size, 32, 3, 0.9)[..., None]


def planks(rng: Generator, size: int, across: int) -> Image:
    """Wooden boards along the rows with grain, butt joints and differing tone."""
    base = colour(rng, 90, 160, 0.25)
    image = np.zeros((size, size, 3), np.float32)
    width = size / across
    grain = cv2.resize(noise(rng, size, 32, 4, 0.9)[:, : size // 8], (size, size), interpolation=cv2.INTER_LINEAR)
    for board in range(across):
        x = -rng.uniform(0, 0.5) * size
        while x < size:
            length = rng.uniform(0.3, 0.6) * size
            _rectangle(image, x, board * width, x + length - 1, (board + 1) * width - 1, base * rng.uniform(0.65, 1.25))
            x += length
    return image + 10 * grain[..., None]


def pattern(rng: Generator, size: int) -> Image:
    """Carpet or cloth: a repeated motif with weave."""
    image = flat(size, colour(rng, 50, 190, 0.5))
    repeat = int(rng.integers(4, 9))
    step = size / repeat
    inks = [[float(v) for v in colour(rng, 20, 230, 0.6)] for _ in range(3)]
    for j in range(repeat):
        for i in range(repeat):
            centre = (int((i + 0.5) * step), int((j + 0.5) * step))
            ink = inks[int(rng.integers(0, 3))]
            if rng.random() < 0.5:
                cv2.circle(image, centre, int(rng.uniform(0.15, 0.45) * step), ink, -1)
            else:
                r = rng.uniform(0.15, 0.45) * step
                _rectangle(image, centre[0] - r, centre[1] - r, centre[0] + r, centre[1] + r, ink)
    return image + 9 * noise(rng, size, 32, 4, 0.95)[..., None]
