"""Rendering: visibility by scan lines with a depth buffer of 2x2 samples per pixel, then shading of what is seen.

Each parallelogram is linear in homogeneous image coordinates: with its corner P and edges A, B in camera coordinates,
``inv([A B P]) @ (x, y, 1)`` is ``(u/z, v/z, 1/z)``. So spans of a scan line come from four linear inequalities, and the
footprint of a pixel on the texture is known exactly, which keeps textures free of aliasing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEAR = 0.05
SKY = -1


@njit(cache=True)
def plane_coefficients(quads: NDArray, cRw: NDArray, camera_in_world: NDArray) -> NDArray:
    """Return (N, 3, 3) rows for u/z, v/z and 1/z of each parallelogram; zeros where it faces away."""
    out = np.zeros((quads.shape[0], 3, 3))
    for k in range(quads.shape[0]):
        p = cRw @ (quads[k, 0] - camera_in_world)
        a = cRw @ quads[k, 1]
        b = cRw @ quads[k, 2]
        n = np.cross(a, b)
        det = n[0] * p[0] + n[1] * p[1] + n[2] * p[2]
        if det < -1e-12:
            out[k, 0] = np.cross(b, p) / det
            out[k, 1] = np.cross(p, a) / det
            out[k, 2] = n / det
    return out


@njit(cache=True)
def _bounds(quad: NDArray, cRw: NDArray, origin: NDArray, K: NDArray) -> tuple[float, float, float, float]:
    """Pixel bounds of the part of a parallelogram in front of the near plane; empty (u0 > u1) if there is none."""
    corners = np.empty((4, 3))
    corners[0] = cRw @ (quad[0] - origin)
    corners[1] = corners[0] + cRw @ quad[1]
    corners[3] = corners[0] + cRw @ quad[2]
    corners[2] = corners[1] + corners[3] - corners[0]
    u0, u1, v0, v1 = 1e9, -1e9, 1e9, -1e9
    for i in range(4):
        p, q = corners[i], corners[(i + 1) % 4]
        if p[2] > NEAR:
            u, v = K[0] * p[0] / p[2] + K[2], K[1] * p[1] / p[2] + K[3]
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        if (p[2] > NEAR) != (q[2] > NEAR):
            f = (NEAR - p[2]) / (q[2] - p[2])
            u = K[0] * (p[0] + f * (q[0] - p[0])) / NEAR + K[2]
            v = K[1] * (p[1] + f * (q[1] - p[1])) / NEAR + K[3]
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    return u0, u1, v0, v1


@njit(cache=True)
def _span(slope: float, start: float, low: float, high: float) -> tuple[float, float]:
    """Shrink [low, high] to where start + slope * i >= 0."""
    if slope > 0:
        return max(low, -start / slope), high
    if slope < 0:
        return low, min(high, -start / slope)
    return (low, high) if start >= 0 else (1.0, 0.0)


@njit(cache=True)
def draw_quads(
    quads: NDArray, planes: NDArray, cRw: NDArray, origin: NDArray, K: NDArray, seen: NDArray, nearness: NDArray
) -> None:
    """Write the number of the nearest parallelogram and its 1/z into the (2H, 2W) sample buffers."""
    rows, columns = seen.shape
    for k in range(quads.shape[0]):
        plane = planes[k]
        if plane[2, 0] == 0 and plane[2, 1] == 0 and plane[2, 2] == 0:
            continue
        u0, u1, v0, v1 = _bounds(quads[k], cRw, origin, K)
        if u0 > u1 or u1 < -0.5 or v1 < -0.5 or 2 * u0 > columns or 2 * v0 > rows:
            continue
        # Sample i lies at pixel (i + 0.5) / 2 - 0.5.
        i0, i1 = max(0.0, math.floor(2 * u0)), min(columns - 1.0, math.ceil(2 * u1 + 1))
        j0, j1 = int(max(0.0, math.floor(2 * v0))), int(min(rows - 1.0, math.ceil(2 * v1 + 1)))
        step = 0.5 / K[0]
        x0 = (-0.25 - K[2]) / K[0]
        du, dv, dw = plane[0, 0] * step, plane[1, 0] * step, plane[2, 0] * step
        for j in range(j0, j1 + 1):
            y = (0.5 * j - 0.25 - K[3]) / K[1]
            u = plane[0, 0] * x0 + plane[0, 1] * y + plane[0, 2]
            v = plane[1, 0] * x0 + plane[1, 1] * y + plane[1, 2]
            w = plane[2, 0] * x0 + plane[2, 1] * y + plane[2, 2]
            low, high = _span(du, u, i0, i1)
            low, high = _span(dv, v, low, high)
            low, high = _span(dw - du, w - u, low, high)
            low, high = _span(dw - dv, w - v, low, high)
            low, high = _span(dw, w - 1e-9, low, high)
            if low > high:
                continue
            for i in range(math.ceil(low), math.floor(high) + 1):
                inverse = np.float32(w + dw * i)
                if inverse > nearness[j, i] and inverse < 1.0 / NEAR:
                    nearness[j, i] = inverse
                    seen[j, i] = k


@njit(cache=True)
def hit_ball(ball: NDArray, origin: NDArray, dx: float, dy: float, dz: float) -> float:
    """Return the depth of the first hit of an ellipsoid, or -1; the ray (dx, dy, dz) has unit z in the camera."""
    ex, ey, ez = ball[1]
    ox, oy, oz = (origin[0] - ball[0, 0]) / ex, (origin[1] - ball[0, 1]) / ey, (origin[2] - ball[0, 2]) / ez
    rx, ry, rz = dx / ex, dy / ey, dz / ez
    a = rx * rx + ry * ry + rz * rz
    b = ox * rx + oy * ry + oz * rz
    c = ox * ox + oy * oy + oz * oz - 1
    d = b * b - a * c
    return (-b - math.sqrt(d)) / a if d > 0 else -1.0


@njit(cache=True)
def _ball_bounds(ball: NDArray, cRw: NDArray, origin: NDArray, K: NDArray, width: float, height: float) -> NDArray:
    """Return the pixel bounds u0, u1, v0, v1 of an ellipsoid, empty (u0 > u1) where it is out of view.

    Wholly in front of the camera, they come from its dual conic ``E - c c^T``, E the squared half axes turned into the
    camera's frame and c the centre; an ellipsoid around the camera's plane may cover the whole image.
    """
    c = cRw @ (ball[0] - origin)
    axes = cRw * ball[1]
    squared = axes @ axes.T
    out = np.array([1.0, 0.0, 1.0, 0.0])
    deep = math.sqrt(squared[2, 2])
    if c[2] + deep <= NEAR:
        return out
    # Wholly outside one of the four sides of the view: the farthest point towards the inside is still outside.
    for axis in range(2):
        low, high = (-0.5 - K[2 + axis]) / K[axis], ((width, height)[axis] - 0.5 - K[2 + axis]) / K[axis]
        for sign, slope in ((1.0, low), (-1.0, high)):
            n = np.zeros(3)
            n[axis], n[2] = sign, -sign * slope
            if n @ c + math.sqrt(n @ squared @ n) < 0:
                return out
    if c[2] - deep <= NEAR:
        return np.array([0.0, width, 0.0, height])
    for axis in range(2):
        p, q = squared[axis, 2] - c[axis] * c[2], squared[2, 2] - c[2] * c[2]
        root = math.sqrt(max(p * p - (squared[axis, axis] - c[axis] * c[axis]) * q, 0.0))
        out[2 * axis] = K[axis] * (p + root) / q + K[2 + axis]
        out[2 * axis + 1] = K[axis] * (p - root) / q + K[2 + axis]
    return out


@njit(cache=True)
def draw_balls(
    balls: NDArray, first: int, cRw: NDArray, origin: NDArray, K: NDArray, seen: NDArray, nearness: NDArray
) -> None:
    """Write the ellipsoids into the sample buffers; their numbers begin with ``first``."""
    rows, columns = seen.shape
    for k in range(balls.shape[0]):
        bounds = _ball_bounds(balls[k], cRw, origin, K, 0.5 * columns, 0.5 * rows)
        if bounds[0] > bounds[1]:
            continue
        i0, i1 = max(0.0, 2 * bounds[0] - 1), min(columns - 1.0, 2 * bounds[1] + 2)
        j0, j1 = max(0.0, 2 * bounds[2] - 1), min(rows - 1.0, 2 * bounds[3] + 2)
        for j in range(int(j0), int(j1) + 1):
            y = (0.5 * j - 0.25 - K[3]) / K[1]
            for i in range(int(i0), int(i1) + 1):
                x = (0.5 * i - 0.25 - K[2]) / K[0]
                dx = cRw[0, 0] * x + cRw[1, 0] * y + cRw[2, 0]
                dy = cRw[0, 1] * x + cRw[1, 1] * y + cRw[2, 1]
                dz = cRw[0, 2] * x + cRw[1, 2] * y + cRw[2, 2]
                z = hit_ball(balls[k], origin, dx, dy, dz)
                if z > NEAR and np.float32(1 / z) > nearness[j, i]:
                    nearness[j, i] = 1 / z
                    seen[j, i] = first + k


@njit(cache=True)
def _hash(a: int, b: int, c: int) -> float:
    """Return a number in [-1, 1] that looks random and depends on the arguments alone."""
    h = (a * 374761393 + b * 668265263 + c * 2147483647 + 1013904223) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 32767.5 - 1.0


@njit(cache=True)
def smooth_noise(x: float, y: float, seed: int) -> float:
    """Return value noise in [-1, 1] with cells of size 1."""
    ix, iy = math.floor(x), math.floor(y)
    fx, fy = x - ix, y - iy
    fx, fy = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy)
    top = _hash(ix, iy, seed) * (1 - fx) + _hash(ix + 1, iy, seed) * fx
    bottom = _hash(ix, iy + 1, seed) * (1 - fx) + _hash(ix + 1, iy + 1, seed) * fx
    return top * (1 - fy) + bottom * fy


@njit(cache=True)
def _texel(
    texels: NDArray, offset: int, rows: int, columns: int, x: float, y: float, weight: float, rgb: NDArray
) -> None:
    """Add a bilinear look-up in one reduced texture, which repeats, to ``rgb``."""
    x, y = x - 0.5, y - 0.5
    ix, iy = math.floor(x), math.floor(y)
    fx, fy = x - ix, y - iy
    x0, x1, y0, y1 = ix & (columns - 1), (ix + 1) & (columns - 1), iy & (rows - 1), (iy + 1) & (rows - 1)
    a = offset + 3 * (y0 * columns + x0)
    b = offset + 3 * (y0 * columns + x1)
    c = offset + 3 * (y1 * columns + x0)
    d = offset + 3 * (y1 * columns + x1)
    wa, wb, wc, wd = (1 - fx) * (1 - fy) * weight, fx * (1 - fy) * weight, (1 - fx) * fy * weight, fx * fy * weight
    for channel in range(3):
        rgb[channel] += (
            wa * texels[a + channel] + wb * texels[b + channel] + wc * texels[c + channel] + wd * texels[d + channel]
        )


@njit(cache=True)
def sample_texture(
    texels: NDArray, offsets: NDArray, size: int, x: float, y: float, wide: float, high: float, rgb: NDArray
) -> None:
    """Look up a texture at texel (x, y) over a footprint of ``wide`` x ``high`` texels; the result replaces ``rgb``."""
    levels = offsets.shape[0]
    lx = min(max(math.log2(max(wide, 1e-6)), 0.0), levels - 1.001)
    ly = min(max(math.log2(max(high, 1e-6)), 0.0), levels - 1.001)
    ix, iy = int(lx), int(ly)
    fx, fy = lx - ix, ly - iy
    rgb[:] = 0.0
    for j in range(2):
        weight_y = fy if j else 1 - fy
        if weight_y == 0:
            continue
        for i in range(2):
            weight = weight_y * (fx if i else 1 - fx)
            if weight > 0:
                level_x, level_y = ix + i, iy + j
                _texel(
                    texels,
                    offsets[level_y, level_x],
                    size >> level_y,
                    size >> level_x,
                    x / (1 << level_x),
                    y / (1 << level_y),
                    weight,
                    rgb,
                )
