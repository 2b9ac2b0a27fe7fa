"""Other programs' normals of one depth image, for scripts/benchmark_normals.py.

Each function sets its libraries to the number of threads and returns runs by name. It raises
ImportError where the peer is not installed.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from nimprep import Camera

Run = Callable[[], np.ndarray]


def opencv(depth: np.ndarray, camera: Camera, threads: int) -> dict[str, Run]:
    """OpenCV 5's RgbdNormals: from depth, and with the points given (the shorter time)."""
    if not hasattr(cv2, "RgbdNormals_create"):
        raise ImportError("OpenCV without RgbdNormals", name="OpenCV 5 (RgbdNormals)")
    cv2.setNumThreads(threads)
    matrix = camera.matrix.astype(np.float32)
    # Its word for no depth; float32 points were faster than float64 in every method.
    with_nan = np.where(depth > 0, depth, np.float32(np.nan))
    millimetres = np.round(depth * 1000).astype(np.uint16)
    points = cv2.depthTo3d(with_nan, matrix)
    rows: dict[str, Run] = {}
    for method in ("FALS", "LINEMOD", "SRI", "CROSS_PRODUCT"):
        kind = getattr(cv2, f"RgbdNormals_RGBD_NORMALS_METHOD_{method}")
        # 3: the smallest window that all methods take, and the fastest.
        estimator = cv2.RgbdNormals_create(*depth.shape, cv2.CV_32F, matrix, 3, 50.0, kind)
        estimator.cache()
        normals = estimator.apply(points)
        rows[f"OpenCV {method}, points given"] = lambda e=estimator, n=normals: e.apply(points, n)
        if method == "LINEMOD":  # takes depth as it is, and 16 bits the fastest
            rows[f"OpenCV {method}"] = lambda e=estimator, n=normals: e.apply(millimetres, n)
        else:
            room = np.empty_like(points)
            rows[f"OpenCV {method}"] = lambda e=estimator, n=normals, p=room: e.apply(
                cv2.depthTo3d(with_nan, matrix, p), n
            )
    return rows


def kornia(depth: np.ndarray, camera: Camera, threads: int) -> dict[str, Run]:
    """Return kornia's cross product of the points' gradients."""
    import torch
    from kornia.geometry.depth import depth_to_normals

    torch.set_num_threads(threads)
    image = torch.from_numpy(depth)[None, None]
    matrix = torch.from_numpy(camera.matrix.astype(np.float32))[None]

    @torch.inference_mode()
    def run() -> np.ndarray:
        return depth_to_normals(image, matrix)[0].permute(1, 2, 0).numpy()

    return {"kornia": run}


def d2nt(depth: np.ndarray, camera: Camera, threads: int) -> dict[str, Run]:
    """D2NT (Feng et al., ICRA 2023), without and with its refinements."""
    from d2nt import depth2normal

    cv2.setNumThreads(threads)
    return {
        f"d2nt {version}": lambda v=version: depth2normal(depth, camera.matrix, version=f"d2nt_{v}")
        for version in ("basic", "v2", "v3")
    }


def paper(depth: np.ndarray, camera: Camera, threads: int) -> dict[str, Run]:
    """NIM as the paper writes it: filters as convolutions, angles phi and theta, in torch."""
    import torch
    from torch.nn.functional import conv2d

    torch.set_num_threads(threads)
    z = torch.from_numpy(depth)
    along_u = torch.tensor([[0.0, 0, 0], [-1, 0, 1], [0, 0, 0]])[None, None]
    along_v = along_u.transpose(2, 3)
    to_neighbours = torch.zeros(4, 1, 1, 3, 3)
    for i, (row, column) in enumerate([(0, 1), (1, 0), (1, 2), (2, 1)]):
        to_neighbours[i, 0, 0, row, column] = 1
        to_neighbours[i, 0, 0, 1, 1] = -1

    @torch.inference_mode()
    def run() -> np.ndarray:
        v, u = torch.meshgrid(
            torch.arange(camera.height, dtype=torch.float32),
            torch.arange(camera.width, dtype=torch.float32),
            indexing="ij",
        )
        points = torch.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
        inverse = (1 / z)[None, None]
        n_x = camera.fx * conv2d(inverse, along_u, padding=1)[0, 0]
        n_y = camera.fy * conv2d(inverse, along_v, padding=1)[0, 0]
        phi = torch.atan(n_y / n_x)
        candidates = []
        for to_neighbour in to_neighbours:
            dx, dy, dz = (conv2d(p[None, None], to_neighbour, padding=1)[0, 0] for p in points)
            n = torch.stack([n_x, n_y, -(n_x * dx + n_y * dy) / dz])
            # A candidate with dz = 0 is no number, and adds nothing.
            candidates.append((n / torch.sqrt((n**2).sum(0))).nan_to_num(0))
        m_x, m_y, m_z = torch.stack(candidates).sum(0)
        theta = torch.atan((m_x * torch.cos(phi) + m_y * torch.sin(phi)) / m_z)
        normal = torch.stack(
            [
                torch.sin(theta) * torch.cos(phi),
                torch.sin(theta) * torch.sin(phi),
                torch.cos(theta),
            ]
        )
        facing = torch.tensor([0.0, 0, -1])[:, None, None]
        normal = torch.where(normal.isnan().any(0), facing, normal)
        normal = torch.where((normal * points).sum(0) > 0, -normal, normal)
        return normal.permute(1, 2, 0).numpy()

    return {"the paper's formulation in torch": run}


PEERS = (opencv, kornia, d2nt, paper)
