"""Signs in depth as metres, and in the camera it is said to be of."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera

LEAST_FOCAL_PX = 5.0
"""A shorter focal length, of a view too wide for any lens, is a share of the image's size."""

_ROWS = 128
_SAMPLED = 10_000
_PLANE_PIXELS = 2048
_LEAST_PIXELS = 100


def depth_signs(
    depth_m: npt.NDArray[np.float32], camera: Camera, most_m: float, *, road: bool = True
) -> dict[str, float]:
    """Measure what tells that depth is not what it is taken for, on a sample of its pixels.

    Parameters
    ----------
    depth_m : (H, W) float32, metres
        Checked; 0 = none.
    camera : Camera
        Of the image's size.
    most_m : float
        The farthest depth that can be kept, metres.
    road : bool
        Whether to look for the road, which takes longer than all the rest.

    Returns
    -------
    dict
        ``with_neighbours``: the share of the pixels with depth that have it beside them on each
        axis, too; ``alone``: of those that have it beside them on none; ``beyond_range``: of those
        beyond `most_m`; ``row_correlation``: of depth with the row in the lower half of the image;
        ``camera_height_m``: the camera's over the road's plane, where one is found. What cannot be
        measured is left out; of an image of
        some hundred pixels that is everything.
    """
    if depth_m.size < _PLANE_PIXELS:
        return {}
    signs = {
        **_shares_with_neighbours(depth_m),
        "beyond_range": _share_beyond(depth_m, most_m),
        "row_correlation": _row_correlation(depth_m),
        "camera_height_m": _camera_height(depth_m, camera) if road else None,
    }
    return {n: value for n, value in signs.items() if value is not None and math.isfinite(value)}


def camera_signs(camera: Camera) -> dict[str, float]:
    """Measure what tells that a camera is not that of its image.

    Parameters
    ----------
    camera : Camera
        Of the whole image: cropping may well leave a principal point outside.

    Returns
    -------
    dict
        ``focal_px``: the shorter focal length; ``view_deg``: the field of view along the image's
        longer side; ``cx_share``, ``cy_share``: where the principal point is, 0 and 1 the edges.
    """
    across, focal = max((camera.width, camera.fx), (camera.height, camera.fy))
    return {
        "focal_px": min(camera.fx, camera.fy),
        "view_deg": 2 * math.degrees(math.atan(across / 2 / focal)),
        "cx_share": (camera.cx + 0.5) / camera.width,
        "cy_share": (camera.cy + 0.5) / camera.height,
    }


def staircase_signs(
    filled_m: npt.NDArray[np.float32], missing: npt.NDArray[np.bool_] | None
) -> dict[str, float]:
    """Measure how much of the depth that was filled in is steps.

    Parameters
    ----------
    filled_m : (H, W) float32, metres
        0 = none.
    missing : (H, W) bool, optional
        Where it was filled in; None = nowhere.

    Returns
    -------
    dict
        ``staircase``: the share of the pixels with depth that were filled in and are exactly as far
        as their four neighbours; of an image of some hundred pixels nothing.
    """
    height, width = filled_m.shape
    if missing is None or filled_m.size < _PLANE_PIXELS or min(height, width) < 3:
        return {}
    rows = _sampled_rows(height)
    here, above, below = (filled_m[rows + step] for step in (0, -1, 1))
    inner = here[:, 1:-1]
    level = (here[:, :-2] == inner) & (here[:, 2:] == inner)
    level &= (above[:, 1:-1] == inner) & (below[:, 1:-1] == inner)
    number = np.count_nonzero(inner)
    made = level & missing[rows][:, 1:-1] & (inner > 0)
    return {"staircase": float(np.count_nonzero(made) / number)} if number >= _LEAST_PIXELS else {}


def _sampled_rows(height: int) -> npt.NDArray[np.intp]:
    """Return some rows that have one above and one below."""
    return np.unique(np.linspace(1, height - 2, _ROWS).astype(np.intp))


def _shares_with_neighbours(depth_m: npt.NDArray[np.float32]) -> dict[str, float]:
    height, width = depth_m.shape
    if min(height, width) < 3:
        return {}
    rows = _sampled_rows(height)
    here, above, below = (depth_m[rows + step] > 0 for step in (0, -1, 1))
    inner = here[:, 1:-1]
    number = np.count_nonzero(inner)
    if number < _LEAST_PIXELS:
        return {}
    along_u, along_v = here[:, :-2] | here[:, 2:], (above | below)[:, 1:-1]
    both, none = inner & along_u & along_v, inner & ~(along_u | along_v)
    shares = {"with_neighbours": both, "alone": none}
    return {name: float(np.count_nonzero(some) / number) for name, some in shares.items()}


def _share_beyond(depth_m: npt.NDArray[np.float32], most_m: float) -> float | None:
    step = max(1, math.isqrt(depth_m.size // _SAMPLED))
    values = depth_m[step // 2 :: step, step // 2 :: step]
    number = np.count_nonzero(values)
    return float(np.count_nonzero(values > most_m) / number) if number >= _LEAST_PIXELS else None


def _row_correlation(depth_m: npt.NDArray[np.float32]) -> float | None:
    lower = depth_m[depth_m.shape[0] // 2 :]
    step = max(1, math.isqrt(lower.size // _SAMPLED))
    part = lower[::step, step // 2 :: step]
    rows, columns = np.nonzero(part)
    values = part[rows, columns].astype(np.float64)
    if values.size < _LEAST_PIXELS or rows.min() == rows.max() or values.min() == values.max():
        return None
    return float(np.corrcoef(rows, values)[0, 1])


def _camera_height(depth_m: npt.NDArray[np.float32], camera: Camera) -> float | None:
    if min(camera.fx, camera.fy) < LEAST_FOCAL_PX:
        return None
    # Here, as its kernels take their time to load.
    from nimprep.derive.coarse_road import coarse_road_plane

    plane = coarse_road_plane(depth_m, camera)
    return None if plane is None else float(plane[3])
