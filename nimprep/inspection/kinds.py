"""The kinds of image that files of a pattern may be."""

from __future__ import annotations

from enum import StrEnum


class Kind(StrEnum):
    """Name what images are."""

    COLOUR = "colour"
    DEPTH = "depth"
    DISPARITY = "disparity"
    DEPTH_PICTURE = "picture of depth"
    LABEL = "label"
    COLOUR_LABEL = "colour label"
    INSTANCES = "instances"
    MASK = "mask"
    CONFIDENCE = "confidence"
    NORMALS = "normals"
    HHA = "hha"
    THERMAL = "thermal"
    COLOUR_AND_THERMAL = "colour and thermal"
    FLOW = "flow"
    GREY = "grey picture"
    CAMERA = "camera"
    IMAGE = "image"
    NONE = ""
