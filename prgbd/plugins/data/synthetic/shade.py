"""Shading: the colour of every pixel from the samples seen in it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from prgbd.plugins.data.synthetic.render import hit_ball, sample_texture, smooth_noise


@njit(cache=True)
def _variation(s: float, t: float, footprint: float, seed: int) -> float:
    """Slow brightness variation at (s, t) metres, without the part that is finer than a pixel."""
    total = 0.0
    wave, gain = 2.7, 0.6
    for octave in range(2):
        fade = min(1.0, max(0.0, 2.0 - 4.0 * footprint / wave))
        if fade > 0:
            total += gain * fade * smooth_noise(s / wave, t / wave, seed + 17 * octave)
        wave, gain = 0.31 * wave, 0.7 * gain
    return total


@njit(cache=True)
def _colour_quad(
    k: int, px: float, py: float, plane: NDArray, quad: NDArray, look: NDArray, atlas: tuple, K: NDArray, rgb: NDArray
) -> None:
    """Write the colour of parallelogram ``k`` at pixel (px, py)."""
    x, y = (px - K[2]) / K[0], (py - K[3]) / K[1]
    w = max(plane[2, 0] * x + plane[2, 1] * y + plane[2, 2], 1e-6)
    u = (plane[0, 0] * x + plane[0, 1] * y + plane[0, 2]) / w
    v = (plane[1, 0] * x + plane[1, 1] * y + plane[1, 2]) / w
    a = math.sqrt(quad[1, 0] ** 2 + quad[1, 1] ** 2 + quad[1, 2] ** 2)
    b = math.sqrt(quad[2, 0] ** 2 + quad[2, 1] ** 2 + quad[2, 2] ** 2)
    # Metres along both edges covered by one pixel.
    s_pixel = a * (abs(plane[0, 0] - u * plane[2, 0]) / K[0] + abs(plane[0, 1] - u * plane[2, 1]) / K[1]) / w
    t_pixel = b * (abs(plane[1, 0] - v * plane[2, 0]) / K[0] + abs(plane[1, 1] - v * plane[2, 1]) / K[1]) / w
    s, t = a * min(max(u, 0.0), 1.0), b * min(max(v, 0.0), 1.0)
    texture = int(look[0])
    sample_texture(
        atlas[0],
        atlas[1][texture],
        atlas[2][texture],
        s * look[1] + look[3],
        t * look[2] + look[4],
        s_pixel * abs(look[1]),
        t_pixel * look[2],
        rgb,
    )
    bright = 1.0
    if look[8] > 0:
        bright += look[8] * _variation(s, t, max(s_pixel, t_pixel), k * 7919)
    for channel in range(3):
        rgb[channel] *= look[5 + channel] * bright


@njit(cache=True)
def _colour_ball(
    k: int,
    px: float,
    py: float,
    ball: NDArray,
    look: NDArray,
    atlas: tuple,
    cRw: NDArray,
    origin: NDArray,
    K: NDArray,
    light: NDArray,
    rgb: NDArray,
) -> bool:
    """Write the colour of ellipsoid ``k`` at pixel (px, py); False if the pixel's ray misses it."""
    x, y = (px - K[2]) / K[0], (py - K[3]) / K[1]
    d = x * cRw[0] + y * cRw[1] + cRw[2]
    z = hit_ball(ball, origin, d[0], d[1], d[2])
    if z <= 0:
        return False
    p = (origin + z * d - ball[0]) / ball[1]
    n = p / ball[1]
    n /= math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    facing = max(0.1, -(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / math.sqrt(x * x + y * y + 1))
    pixel = z / K[0]
    around = math.atan2(p[2], p[0]) * 0.5 * (ball[1, 0] + ball[1, 2])
    along = p[1] * ball[1, 1]
    texture = int(look[0])
    wide = pixel / facing * abs(look[1])
    sample_texture(
        atlas[0],
        atlas[1][texture],
        atlas[2][texture],
        around * look[1],
        along * look[2],
        wide / max(0.2, math.sqrt(max(0.0, 1 - p[1] * p[1]))),
        wide,
        rgb,
    )
    bright = light[3] + (1 - light[3]) * max(0.0, n[0] * light[0] + n[1] * light[1] + n[2] * light[2])
    for channel in range(3):
        rgb[channel] *= look[5 + channel] * bright
    return True


@njit(cache=True)
def _colour_sky(px: float, py: float, cRw: NDArray, K: NDArray, sky: NDArray, rgb: NDArray) -> None:
    """Write the colour of the sky (or of darkness indoors): a gradient with soft clouds, fixed in direction."""
    x, y = (px - K[2]) / K[0], (py - K[3]) / K[1]
    d = x * cRw[0] + y * cRw[1] + cRw[2]
    d /= math.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    height = max(0.0, -d[1])
    cloud = 0.0
    gain = sky[6]
    scale = 2.0
    for octave in range(4):
        # The plane of the clouds meets the horizon smoothly.
        cloud += gain * smooth_noise(scale * d[0] / (height + 0.35), scale * d[2] / (height + 0.35), 91 + octave)
        scale, gain = 2.1 * scale, 0.55 * gain
    for channel in range(3):
        rgb[channel] = sky[channel] + (sky[3 + channel] - sky[channel]) * min(1.0, 1.6 * height) + cloud


@njit(cache=True)
def shade(
    seen: NDArray,
    nearness: NDArray,
    planes: NDArray,
    quads: NDArray,
    quad_look: NDArray,
    balls: NDArray,
    ball_look: NDArray,
    atlas: tuple,
    cRw: NDArray,
    origin: NDArray,
    K: NDArray,
    light: NDArray,
    sky: NDArray,
    image: NDArray,
    depth: NDArray,
) -> None:
    """Fill ``image`` (H, W, 3) float32 and ``depth`` (H, W) float32, the depth at the pixel's centre (sky: 0).

    A pixel whose four samples see one surface is shaded once at its centre; otherwise every sample counts a quarter.
    """
    number = quads.shape[0]
    rgb = np.zeros(3)
    ids = np.empty(4, np.int64)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            best, most = 0, 0
            for i in range(4):
                ids[i] = seen[2 * row + i // 2, 2 * column + i % 2]
            for i in range(4):
                count = 0
                for j in range(4):
                    count += ids[j] == ids[i]
                if count > most:
                    best, most = i, count
            for i in range(4):
                count, first = 0, True
                for j in range(4):
                    if ids[j] == ids[i]:
                        first = first and j >= i
                        count += 1
                if not first:
                    continue
                px, py = float(column), float(row)
                if count < 4:
                    px, py = column - 0.25 + 0.5 * (i % 2), row - 0.25 + 0.5 * (i // 2)
                k = ids[i]
                if k < 0:
                    _colour_sky(px, py, cRw, K, sky, rgb)
                elif k < number:
                    _colour_quad(k, px, py, planes[k], quads[k], quad_look[k], atlas, K, rgb)
                else:
                    b = k - number
                    if not _colour_ball(b, px, py, balls[b], ball_look[b], atlas, cRw, origin, K, light, rgb):
                        _colour_sky(px, py, cRw, K, sky, rgb)
                for channel in range(3):
                    image[row, column, channel] += 0.25 * count * rgb[channel]
            k = ids[best]
            if k < 0:
                depth[row, column] = 0.0
            elif k < number:
                x, y = (column - K[2]) / K[0], (row - K[3]) / K[1]
                inverse = planes[k, 2, 0] * x + planes[k, 2, 1] * y + planes[k, 2, 2]
                sample = nearness[2 * row + best // 2, 2 * column + best % 2]
                depth[row, column] = 1.0 / (inverse if inverse > 0.5 * sample else sample)
            else:
                d = (column - K[2]) / K[0] * cRw[0] + (row - K[3]) / K[1] * cRw[1] + cRw[2]
                z = hit_ball(balls[k - number], origin, d[0], d[1], d[2])
                depth[row, column] = z if z > 0 else 1.0 / nearness[2 * row + best // 2, 2 * column + best % 2]
