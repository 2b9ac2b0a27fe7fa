"""A scene as data, and how a random one is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from nimprep.synthetic.ground import Kerb, Pothole, Strip
from nimprep.synthetic.shapes import Rotation, Vector
from nimprep.synthetic.solids import Ball, Box, Cylinder
from nimprep.synthetic.texture import Colour

Ground: TypeAlias = Strip | Kerb | Pothole
Solid: TypeAlias = Box | Ball | Cylinder

BACKGROUND, DRIVABLE, ANOMALY = 0, 1, 2
"""GMRP's labels."""


@dataclass(frozen=True)
class Light:
    """Describe the weather.

    Attributes
    ----------
    to_sun : Vector
        Unit vector towards the sun.
    sun, ambient : Colour
        Light that falls on a surface from the sun alone and from all around.
    zenith, horizon, skyline : Colour
        Colours of the sky above, of the sky low down and of the far trees.
    skyline_height : float
        Mean tangent of the far trees' elevation.
    clouds : float
        0 clear to 1 overcast.
    """

    to_sun: Vector
    sun: Colour
    ambient: Colour
    zenith: Colour
    horizon: Colour
    skyline: Colour
    skyline_height: float
    clouds: float


@dataclass(frozen=True)
class Scene:
    """Describe all that a camera at the scene frame's origin looks at.

    Attributes
    ----------
    rotation : Rotation
        Camera frame to scene frame.
    ground : tuple of Ground
        Pieces of the ground, seen from above only.
    solids : tuple of Solid
        What stands on it and casts shadows.
    light : Light
        Weather.
    """

    rotation: Rotation
    ground: tuple[Ground, ...]
    solids: tuple[Solid, ...]
    light: Light

    @property
    def surfaces(self) -> tuple[Ground | Solid, ...]:
        """Everything that a ray can meet."""
        return (*self.ground, *self.solids)
