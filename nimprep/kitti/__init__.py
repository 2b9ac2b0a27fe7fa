"""The KITTI road benchmark: calibration, dense depth, bird's-eye view, scores and submission.

The public names are imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nimprep.kitti.bev import transform_to_bev as transform_to_bev
    from nimprep.kitti.calibration import Calibration as Calibration
    from nimprep.kitti.calibration import read_calibration as read_calibration
    from nimprep.kitti.depth import write_depth as write_depth
    from nimprep.kitti.evaluation import evaluate_predictions as evaluate_predictions
    from nimprep.kitti.lidar import project_lidar as project_lidar
    from nimprep.kitti.lidar import read_velodyne as read_velodyne
    from nimprep.kitti.overlay import draw_overlay as draw_overlay
    from nimprep.kitti.overlay import write_overlays as write_overlays
    from nimprep.kitti.stereo import match_stereo as match_stereo
    from nimprep.kitti.stereo import stereo_depth as stereo_depth
    from nimprep.kitti.submission import pack_submission as pack_submission
    from nimprep.kitti.transform import transform_folder as transform_folder

_HOME = {
    "Calibration": "calibration",
    "draw_overlay": "overlay",
    "evaluate_predictions": "evaluation",
    "match_stereo": "stereo",
    "pack_submission": "submission",
    "project_lidar": "lidar",
    "read_calibration": "calibration",
    "read_velodyne": "lidar",
    "stereo_depth": "stereo",
    "transform_folder": "transform",
    "transform_to_bev": "bev",
    "write_depth": "depth",
    "write_overlays": "overlay",
}

__all__ = [*_HOME]


if not TYPE_CHECKING:
    # A type checker knows the names above, and that there are no others.
    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
