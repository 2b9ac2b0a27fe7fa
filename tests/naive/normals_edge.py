"""Edge-aware normals pixel by pixel and cell by cell, from what the kernels' texts say, in float64.

Weights alone are the kernels' own to the bit: they are one over an energy to within 12 % only.
"""

from __future__ import annotations

import math

import numpy as np

AROUND = [(-1, 0), (1, 0), (0, -1), (0, 1)]


def weight_of(energy):
    """Return about 1 / energy: a constant less the bits of the float32."""
    bits = np.array(energy, np.float32).view(np.int32)
    return float(np.int32(0x7EF311C7 - int(bits)).view(np.float32))


def inverse_depth(depth, scale):
    """Return scaled inverse depth, 0 = none, as the kernels' float32 has it."""
    scaled = np.clip(depth * np.float32(scale), np.float32(2**-20), np.float32(2**20))
    return np.where(depth > 0, np.float32(1) / scaled, np.float32(0))


def noise_floor(r, smoothing):
    return smoothing.variance + r**2 * (1e-14 + smoothing.quartic * r**2)


def axis_gradient(row, floor):
    """Return gradient and energy at the middle one of five, 0 = none."""
    a, b, c, d, e = map(float, row)
    pair_floor = 8 * floor + 1e-6 * c * c
    found = []
    if a > 0 and b > 0:
        found.append(((3 * c - 4 * b + a) / 2, weight_of((a - 2 * b + c) ** 2 + floor)))
    if b > 0 and d > 0:
        found.append(((d - b) / 2, 4 * weight_of((b - 2 * c + d) ** 2 + floor)))
    if d > 0 and e > 0:
        found.append(((-3 * c + 4 * d - e) / 2, weight_of((c - 2 * d + e) ** 2 + floor)))
    if b > 0:
        found.append((c - b, weight_of(8 * (c - b) ** 2 + pair_floor)))
    if d > 0:
        found.append((d - c, weight_of(8 * (d - c) ** 2 + pair_floor)))
    energy = 1 / (sum(weight for _, weight in found) + 1e-20)
    return sum(g * weight for g, weight in found) * energy, energy


def around(image, v, u):
    """Return the five values about a pixel along u and along v; 0 outside the image."""
    padded = np.pad(image, 2)
    return padded[v + 2, u : u + 5], padded[v : v + 5, u + 2]


def gradients(r, floor_of):
    """Return g_u, g_v and energy of every pixel, (H, W) each; energy inf where r is none."""
    g_u, g_v, energy = np.zeros(r.shape), np.zeros(r.shape), np.full(r.shape, np.inf)
    for v, u in zip(*np.nonzero(r), strict=True):
        along_u, along_v = around(r, v, u)
        g_u[v, u], energy_u = axis_gradient(along_u, floor_of(float(r[v, u])))
        g_v[v, u], energy_v = axis_gradient(along_v, floor_of(float(r[v, u])))
        energy[v, u] = energy_u + energy_v
    return g_u, g_v, energy


def cells_of(r, side):
    """Return share, centroid (u, v) from the cell's centre and mean of each cell."""
    rows, columns = (-(-size // side) for size in r.shape)
    share, mean = np.zeros((2, rows, columns))
    centroid = np.zeros((rows, columns, 2))
    for j in range(rows):
        for i in range(columns):
            cell = r[j * side : (j + 1) * side, i * side : (i + 1) * side].astype(np.float64)
            v, u = np.nonzero(cell)
            if len(v) * 8 >= side * side:
                share[j, i], mean[j, i] = len(v) / side**2, cell[v, u].mean()
                centroid[j, i] = u.mean() - (side - 1) / 2, v.mean() - (side - 1) / 2
    return share, centroid, mean


def fitted(share, centre, plane, variance):
    """Return a cell's plane (r, a, b) refitted to the cells around it, and the sum of weights.

    ``share`` and ``centre`` are (7, 7) or (3, 3); a and b are per cell.
    """
    reach = len(share) // 2
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    miss = centre - (plane[0] + plane[1] * x + plane[2] * y)
    off = 1 + miss**2 / (9 * variance)
    weight = share * np.vectorize(weight_of)(off**2)
    columns = np.stack([np.ones(x.shape), x, y], axis=-1).reshape(-1, 3)
    total = weight.sum()
    # Ridge on the slopes alone, about the weighted mean: per unit of weight.
    mean = weight.reshape(-1) @ columns / total
    about = columns - mean
    normal = (about[:, 1:].T * weight.reshape(-1)) @ about[:, 1:] / total + 1e-3 * np.eye(2)
    target = (about[:, 1:].T * weight.reshape(-1)) @ miss.reshape(-1) / total
    turn = np.linalg.solve(normal, target)
    shift = (weight * miss).sum() / total - turn @ mean[1:]
    return (plane[0] + shift, plane[1] + turn[0], plane[2] + turn[1]), total


def cell_planes(r, smoothing):
    """Return a dictionary of (v, u) of each cell's plane and its energy."""
    side = smoothing.side
    if not smoothing.apart:
        found = planes_of(*cells_of(r, side), side, 3, smoothing.averaging, smoothing)
        return {place: plane for place, (plane, _) in found.items()}
    quarters = cells_of(r, side // 2)
    coarse = planes_of(*merged(*quarters, side // 2), side, 3, smoothing.averaging, smoothing)
    averaging = min(1, 4 * smoothing.averaging)
    fine = planes_of(*quarters, side // 2, 1, averaging, smoothing)
    return chosen(fine, coarse, quarters, smoothing)


def merged(share, centroid, mean, side):
    """Return what `cells_of` returns of cells of four, `side` pixels wide each."""
    rows, columns = (-(-size // 2) for size in share.shape)
    shares, means, centroids = (
        np.zeros((rows, columns)),
        np.zeros((rows, columns)),
        np.zeros((rows, columns, 2)),
    )
    for v, u in np.ndindex(share.shape):
        j, i = v // 2, u // 2
        shares[j, i] += share[v, u] / 4
        means[j, i] += share[v, u] * mean[v, u] / 4
        offset = (np.array([u % 2, v % 2]) - 0.5) * side
        centroids[j, i] += share[v, u] * (centroid[v, u] + offset) / 4
    known = shares > 0.125
    per = np.where(known, 1 / np.maximum(shares, 1e-30), 0)
    return shares * known, centroids * per[..., None], means * per


def chosen(fine, coarse, quarters, smoothing):
    """Return the plane of each quarter: its own, or its cell's where the two differ by noise."""
    side = smoothing.side // 2
    off, misses = {}, {}
    for (j, i), ((_, g_u, g_v, _), _) in fine.items():
        if (j // 2, i // 2) in coarse:
            _, a, b, _ = coarse[j // 2, i // 2][0]
            off[j, i] = fine[j, i][1][1] * np.array([g_u - a, g_v - b])
    for j, i in off:
        near = [
            off[v, u] for v in range(j - 1, j + 2) for u in range(i - 1, i + 2) if (v, u) in off
        ]
        variance = 12 * smoothing.apart * noise_floor(fine[j, i][1][0], smoothing) / side**2
        mean = sum(near) / len(near)
        misses[j, i] = min(mean @ mean / (0.6**4 * variance), 1e6)
    planes = {}
    rows, columns = quarters[0].shape
    for j, i in np.ndindex(rows + rows % 2, columns + columns % 2):
        near = [
            misses[v, u]
            for v in range(j - 2, j + 3)
            for u in range(i - 2, i + 3)
            if (v, u) in misses
        ]
        level = sum(near) <= 9 * len(near)
        if (j, i) in fine and not (level and (j // 2, i // 2) in coarse):
            planes[j, i] = fine[j, i][0]
        elif (j // 2, i // 2) in coarse:
            planes[j, i] = cell_in_quarter(coarse[j // 2, i // 2][0], j, i, side)
    return planes


def cell_in_quarter(plane, j, i, side):
    """Return a cell's plane with its inverse depth at a quarter's centre."""
    at, g_u, g_v, energy = plane
    return at + ((i % 2) - 0.5) * side * g_u + ((j % 2) - 0.5) * side * g_v, g_u, g_v, energy


def planes_of(share, centroid, mean, side, reach, averaging, smoothing):
    """Return by (v, u) each plane with its energy, and inverse depth and sum of weights."""

    def variance(value):
        floor = noise_floor(value, smoothing)
        return averaging * floor + 1e-14 * value**2 + 1e-30

    g_u, g_v, _ = gradients(mean, variance)
    centre = mean - (g_u * centroid[..., 0] + g_v * centroid[..., 1]) / side
    shares, centres = np.pad(share, reach), np.pad(centre, reach)
    planes = {}
    for j, i in zip(*np.nonzero(share), strict=True):
        plane = centre[j, i], g_u[j, i], g_v[j, i]
        window = slice(j, j + 2 * reach + 1), slice(i, i + 2 * reach + 1)
        for _ in range(2):
            plane, total = fitted(shares[window], centres[window], plane, variance(centre[j, i]))
        energy = 12 * variance(centre[j, i]) / (total * side) ** 2
        energy += 64 * noise_floor(centre[j, i], smoothing) / total**4
        planes[j, i] = (plane[0], plane[1] / side, plane[2] / side, energy), (centre[j, i], total)
    return planes


def cell_shares(planes, r, v, u, smoothing):
    """Return (g_u, g_v, weight) of the cells around a pixel."""
    side = smoothing.side // 2 if smoothing.apart else smoothing.side
    value = float(r[v, u])
    found = []
    j, i = (v - side // 2) // side, (u - side // 2) // side
    for row, column in ((j, i), (j, i + 1), (j + 1, i), (j + 1, i + 1)):
        if (row, column) not in planes:
            continue
        at, g_u, g_v, energy = planes[row, column]
        x, y = u - (column + 0.5) * side + 0.5, v - (row + 0.5) * side + 0.5
        share = (1 - abs(x) / side) * (1 - abs(y) / side)
        miss = value - (at + g_u * x + g_v * y)
        beyond = max(miss**2 - 9 * noise_floor(value, smoothing), 0)
        found.append((g_u, g_v, 16 * share * weight_of(energy + 8 * beyond)))
    return found


def estimate_normals(depth, camera, scale, smoothing):
    """Return (H, W, 3) float64 normals of (H, W) float32 depth in metres, 0 = none.

    ``smoothing`` is what `choose_smoothing` returns.
    """
    r = inverse_depth(depth, scale)
    g_u, g_v, energy = gradients(r, lambda value: noise_floor(value, smoothing))
    planes = cell_planes(r, smoothing) if smoothing.side else {}
    out = np.zeros((*depth.shape, 3))
    for v, u in zip(*np.nonzero(r), strict=True):
        found = [(g_u[v, u], g_v[v, u], 8 * weight_of(energy[v, u]))]
        beside = 0
        for du, dv in AROUND:
            j, i = v + dv, u + du
            if 0 <= j < r.shape[0] and 0 <= i < r.shape[1] and r[j, i] > 0:
                beside += 1
                miss = float(r[v, u]) - (float(r[j, i]) - g_u[j, i] * du - g_v[j, i] * dv)
                weight = weight_of(energy[j, i] + 8 * miss**2)
                found.append((g_u[j, i], g_v[j, i], weight))
        if smoothing.side:
            found += cell_shares(planes, r, v, u, smoothing)
        if not beside:
            continue
        total = sum(weight for _, _, weight in found)
        a = sum(weight * g for g, _, weight in found) / total
        b = sum(weight * g for _, g, weight in found) / total
        x, y = u - camera.cx, v - camera.cy
        normal = np.array([camera.fx * a, camera.fy * b, float(r[v, u]) - a * x - b * y])
        out[v, u] = -normal / math.sqrt(normal @ normal)
    return out
