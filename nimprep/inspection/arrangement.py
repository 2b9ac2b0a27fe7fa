"""Which patterns make a frame: colour, depth and label that go together, camera and splits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from nimprep.inspection.encodings import Encoding
from nimprep.inspection.examination import CameraFiles, Examination, Plane
from nimprep.inspection.kinds import Kind
from nimprep.inspection.pairing import Pairing, common_end, paired, stamp_unit
from nimprep.inspection.words import words_of


@dataclass
class Part:
    """Hold a pattern of a frame's, as a description has it."""

    plane: Plane
    files: str
    matched: int


@dataclass
class Arrangement:
    """Say which patterns make a frame.

    Attributes
    ----------
    color : Part
    depth, label, thermal, mask : Part, optional
        `mask` says where depth is valid.
    encoding : Encoding, optional
        Of depth.
    camera : CameraFiles, optional
    camera_files : str
    stamp_unit : float, optional
        Files are paired by time.
    notes : list of str
    """

    color: Part
    depth: Part | None = None
    label: Part | None = None
    thermal: Part | None = None
    mask: Part | None = None
    encoding: Encoding | None = None
    camera: CameraFiles | None = None
    camera_files: str = ""
    stamp_unit: float | None = None
    notes: list[str] = field(default_factory=list)


def arranged(
    found: Examination, depths: Sequence[tuple[Plane, list[Encoding]]]
) -> Arrangement | None:
    """Return what makes a frame; None = there are no colour images."""
    colors = _colors(found)
    if not colors:
        return None
    usable = [(plane, encodings) for plane, encodings in depths if encodings]
    color = max(colors, key=lambda plane: _worth(plane, [plane for plane, _ in usable]))
    form = _Form(color)
    made = Arrangement(Part(color, "", len(color.template.members)))
    best = max(usable, key=lambda pair: form.fit(pair[0]), default=None)
    if best is not None and form.take(best[0]):
        made.depth, made.encoding = Part(best[0], "", form.matched), best[1][0]
    elif best is not None:
        made.stamp_unit = stamp_unit(color.template, best[0].template)
        if made.stamp_unit is None:
            made.notes.append(f"{best[0].pattern}: no way found to pair it with colour")
        else:
            made.depth, made.encoding = Part(best[0], "", 0), best[1][0]
            form.others[best[0].pattern] = "{id}"
    made.label = _chosen(form, _labels(found))
    made.thermal = _chosen(form, found.of_kind(Kind.THERMAL))
    if made.depth is not None:
        masks = [plane for plane in found.of_kind(Kind.MASK) if _is_validity(plane)]
        made.mask = _chosen(form, masks)
    _add_camera(made, form, found, made.depth.plane if made.depth else color)
    made.color.files = form.color_files()
    for part in (made.depth, made.label, made.thermal, made.mask):
        if part is not None:
            part.files = form.files(part.plane.template.pattern)
    return made


def _colors(found: Examination) -> list[Plane]:
    pictures = found.of_kind(Kind.COLOUR, Kind.COLOUR_AND_THERMAL)
    return pictures or found.of_kind(Kind.GREY)


def _worth(plane: Plane, depths: Sequence[Plane]) -> tuple[float, ...]:
    """Return how good a pattern is as a frame's colour: with depth, named so, many."""
    words = set(words_of(plane.name))
    score = 0.0
    score += 2 * bool(words & {"rgb", "color", "colour", "rgbs", "colors"})
    score += 1 * bool(words & {"image", "images", "left", "img", "pylon"})
    score -= 2 * bool(words & {"right", "vis", "overlay", "preview", "render", "blend", "hha"})
    score -= 1 * ("image_3" in plane.pattern or "image_1" in plane.pattern)
    pairs = [p for depth in depths if (p := paired(plane.template, depth.template))]
    matched = max((pair.matched for pair in pairs), default=0)
    return (bool(matched), score, len(plane.template.members))


def _is_validity(plane: Plane) -> bool:
    return bool({"depth", "valid", "validity"} & set(words_of(plane.name)))


def _labels(found: Examination) -> list[Plane]:
    order = {Kind.LABEL: 0, Kind.COLOUR_LABEL: 2, Kind.MASK: 3}
    later = {"color", "colour", "instance", "edge", "vis", "lane", "raw", "full", "13", "37", "894"}

    def rank(plane: Plane) -> int:
        return order[plane.kind] + len(later & set(words_of(plane.name)))

    labels = [plane for plane in found.of_kind(*order) if not _is_validity(plane)]
    return sorted(labels, key=rank)


def _chosen(form: _Form, planes: Sequence[Plane]) -> Part | None:
    """Return the first pattern of those that has a file for most colour images, in its place."""
    for plane in planes:
        if form.fit(plane)[0] and form.take(plane):
            return Part(plane, "", form.matched)
    return None


class _Form:
    """How a frame's files are called, as far as it is known."""

    def __init__(self, color: Plane) -> None:
        self._color = color.template
        self.color = "*" if "{id}" in self._color.folder else "{id}"
        if self._color.fixed:
            self.color = ""
        self.others: dict[str, str] = {}
        self.matched = 0

    def fit(self, plane: Plane) -> tuple[int, int]:
        """Return how many frames have such a file, and how many files there are."""
        pair = paired(self._color, plane.template)
        return (pair.matched if pair else 0, plane.count)

    def take(self, plane: Plane) -> bool:
        """Settle how a pattern's files are called; False = it does not go with the others."""
        template = plane.template
        if template is self._color:
            self.others[template.pattern] = self.color
            self.matched = len(template.members)
            return True
        pair = paired(self._color, template)
        if pair is None or not pair.matched:
            return False
        pair = self._narrowed(pair, plane)
        if not self._agree(pair):
            return False
        self.others[template.pattern] = pair.other
        self.matched = pair.matched
        return True

    def _agree(self, pair: Pairing) -> bool:
        if pair.color == self.color or "" in (pair.other, self.color):
            return True
        if self.color in ("{id}", "*"):
            # What was called as colour until now still is.
            self.others = {k: pair.color if v == self.color else v for k, v in self.others.items()}
            self.color = pair.color
            return True
        return pair.color == "{id}" == pair.other

    def _narrowed(self, pair: Pairing, plane: Plane) -> Pairing:
        """Return a pairing of those colour images alone that have the other, where names tell."""
        if pair.color == "{id}" == pair.other and self.color == "{id}":
            ours = [member.stem for member in self._color.members]
            end = common_end([m.stem for m in plane.template.members], ours)
            if end:
                return replace(pair, color=f"{{id}}{end}", other=f"{{id}}{end}")
        if pair.color == "{id}" == pair.other:
            return replace(pair, color=self.color, other=self.color)
        return pair

    def color_files(self) -> str:
        if self._color.fixed:
            return self._color.pattern
        pattern = self._color.pattern
        return f"{self._color.folder}{self.color}{pattern[pattern.rfind('.') :]}"

    def files(self, pattern: str) -> str:
        ending = pattern[pattern.rfind(".") :]
        folder = pattern[: pattern.rfind("/") + 1]
        name = self.others[pattern]
        if not name or not set("{*") & set(pattern.rpartition("/")[2]):
            return pattern
        return f"{folder}{name}{ending}"


def _add_camera(made: Arrangement, form: _Form, found: Examination, plane: Plane) -> None:
    from nimprep.inspection.depth_guess import camera_for

    camera = camera_for(found, plane)
    if camera is None:
        return
    template = camera.template
    pair = paired(made.color.plane.template, template)
    if template.fixed:
        if pair is not None or not template.members[0].captured:
            made.camera, made.camera_files = camera, template.pattern
        return
    if pair is None or not pair.matched:
        if len(template.members) == 1:
            made.camera, made.camera_files = camera, template.members[0].path
        return
    if pair.color == "{id}" == pair.other:
        pair = replace(pair, color=form.color, other=form.color)
    if pair.color != form.color and form.color in ("{id}", "*"):
        form.others = {k: pair.color if v == form.color else v for k, v in form.others.items()}
        form.color = pair.color
    if pair.color == form.color:
        ending = template.members[0].name[len(template.members[0].stem) :]
        made.camera, made.camera_files = camera, f"{template.folder}{pair.other}{ending}"
