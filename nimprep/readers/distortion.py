"""What a lens does to a pinhole's image: named models, and numbers of any format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nimprep.errors import CameraError

_BROWN = (
    *("plumbbob", "brown", "brownconrady", "radtan", "radialtangential", "rationalpolynomial"),
    *("rational", "opencv", "fullopencv", "simpleradial", "radial", "pinhole", "perspective"),
)
_FISHEYE = (
    *("equidistant", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4"),
    *("kannalabrandt8", "kb4", "simpleradialfisheye", "radialfisheye"),
)
_NONE = ("", "none", "rectified", "simplepinhole")

_COUNTS = {"brown": (4, 5, 8, 12, 14), "fisheye": (4,)}


@dataclass(frozen=True)
class Distortion:
    """Hold a lens's distortion.

    Attributes
    ----------
    model : str
        "brown": Brown-Conrady (D. C. Brown, 1966) with OpenCV's rational, prism and tilt terms;
        "fisheye": Kannala and Brandt (2006), equidistant; else what the file calls it.
    coefficients : tuple of float
        In OpenCV's order: k1, k2, p1, p2[, k3[, k4, k5, k6[, s1 to s4[, tx, ty]]]], or k1 to k4.
    """

    model: str
    coefficients: tuple[float, ...]

    def __str__(self) -> str:
        numbers = ", ".join(f"{c:g}" for c in self.coefficients[:8])
        return f"{self.model} distortion ({numbers})"

    def check(self, where: str) -> None:
        """Raise `CameraError` where nobody here can take it out."""
        counts = _COUNTS.get(self.model)
        if counts is None or len(self.coefficients) not in counts:
            raise CameraError(
                f"{where}: expected distortion of the models plumb_bob, rational_polynomial or "
                f"equidistant, found {self.model[:80]} with {len(self.coefficients)} numbers; "
                "undistort the images, and say so by --distortion rectified"
            )


def distortion_from(model: str | None, coefficients: Sequence[float]) -> Distortion | None:
    """Return a distortion by its model's name in any of the formats; None = there is none.

    Without a name, coefficients are OpenCV's. A name that is not known is kept, to be refused.
    """
    if not any(coefficients):
        return None
    plain = (model or "opencv").lower().rpartition("distortion.")[2]
    plain = "".join(letter for letter in plain if letter.isalnum())
    numbers = tuple(map(float, coefficients))
    if plain in _FISHEYE:
        # Some write five, the last 0.
        return Distortion("fisheye", _filled(numbers, 4))
    if plain in _BROWN or plain in _NONE:
        return Distortion("brown", _filled(numbers, 4 if len(numbers) <= 4 else len(numbers)))
    return Distortion(model or "", numbers)


def _filled(numbers: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Return as many numbers, with 0 for those that are not given, without 0 at the end."""
    while len(numbers) > count and numbers[-1] == 0:
        numbers = numbers[:-1]
    return numbers + (0.0,) * (count - len(numbers))


def known_projection(name: str) -> bool:
    """Return whether a camera model's name says a pinhole, with or without such a distortion."""
    plain = "".join(letter for letter in name.lower() if letter.isalnum())
    return plain in (*_BROWN, *_FISHEYE, *_NONE)
