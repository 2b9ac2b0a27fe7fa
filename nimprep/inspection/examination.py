"""What lies below a folder, pattern by pattern, decoded as far as it takes to tell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from nimprep.errors import DecodeError
from nimprep.files import read_start
from nimprep.images import Raw
from nimprep.inspection.bare_numbers import ENDINGS as BARE
from nimprep.inspection.bare_numbers import bare_layout, bare_samples
from nimprep.inspection.calibrations import ENDINGS, Calibration, calibration_in
from nimprep.inspection.camera_forms import calibration_by_reader
from nimprep.inspection.containers import CONTAINERS, Held, arrays_in, samples_of
from nimprep.inspection.holdings import Holding, holding_at
from nimprep.inspection.kinds import Kind
from nimprep.inspection.planes import Guess, guessed
from nimprep.inspection.samples import IMAGES, Sample, sampled, some_of
from nimprep.inspection.survey import Survey
from nimprep.inspection.templates import Template, templates_of
from nimprep.inspection.words import has_role, has_words

MOST_PATTERNS = 60
"""Patterns of images beyond so many, those of fewest files, are not decoded."""


@dataclass(frozen=True)
class Plane:
    """Hold the images of one pattern.

    Attributes
    ----------
    template : Template
    samples : tuple of Sample
        Decoded, at least one.
    guess : Guess
    held : Held, optional
        Which array of containers.
    raw : Raw, optional
        What files of bare numbers hold.
    """

    template: Template
    samples: tuple[Sample, ...]
    guess: Guess
    held: Held | None = None
    raw: Raw | None = None

    @property
    def pattern(self) -> str:
        return self.template.pattern

    @property
    def name(self) -> str:
        """The pattern, with the key of an array after it."""
        return f"{self.pattern}/{self.held.key}" if self.held and self.held.key else self.pattern

    @property
    def count(self) -> int:
        """How many images there are."""
        return self.held.frames if self.held and self.held.frames else len(self.template.members)

    @property
    def kind(self) -> Kind:
        return self.guess.kind


@dataclass(frozen=True)
class CameraFiles:
    """Hold camera files of one pattern, and what the first says."""

    template: Template
    calibration: Calibration


@dataclass
class Examination:
    """Hold what was found below a folder.

    Attributes
    ----------
    survey : Survey
    planes : list of Plane
    cameras : list of CameraFiles
    texts : list of Template
        Text files that are no cameras: lists of frames, notes.
    clouds : list of Template
        LiDAR scans and point clouds.
    others : list of Template
    holdings : list of Holding
    problems : list of str
        One line each.
    """

    survey: Survey
    planes: list[Plane] = field(default_factory=list)
    cameras: list[CameraFiles] = field(default_factory=list)
    texts: list[Template] = field(default_factory=list)
    clouds: list[Template] = field(default_factory=list)
    others: list[Template] = field(default_factory=list)
    holdings: list[Holding] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def of_kind(self, *kinds: Kind) -> list[Plane]:
        return [plane for plane in self.planes if plane.kind in kinds]


def examined(survey: Survey) -> Examination:
    """Look at the files of every pattern."""
    found = Examination(survey, problems=list(survey.problems))
    templates = templates_of(survey.files, lambda path: _first_bytes(survey.root / path))
    templates.sort(key=lambda template: -len(template.members))
    images = 0
    for template in templates:
        if template.ending in CONTAINERS and _add_arrays(found, template):
            continue
        if template.ending in IMAGES and images < MOST_PATTERNS:
            images += 1
            _add_images(found, template)
        else:
            _add_other(found, template)
    for template in [t for t in (*found.others, *found.clouds) if t.ending in BARE]:
        _add_bare(found, template)
    found.planes.sort(key=lambda plane: plane.name)
    return found


def _first_bytes(path: Path) -> str:
    """Return what a PNG's header says of its pixels; "" for all else."""
    try:
        start = read_start(path, 29)
    except DecodeError:
        return ""
    return f"{start[24]}-{start[25]}" if start[12:16] == b"IHDR" and len(start) == 29 else ""


def _paths(root: Path, template: Template) -> list[Path]:
    return [root / member.path for member in template.members]


def _add_images(found: Examination, template: Template) -> None:
    root = found.survey.root
    problems: list[str] = []
    chosen = [root / member.path for member in some_of(template.members)]
    samples = sampled(chosen, problems, root)
    if samples:
        same = [s for s in samples if (s.channels, s.pixels.dtype) == _kind_of(samples)]
        guess = guessed(template.pattern, same)
        found.planes.append(Plane(template, tuple(same), guess))
        found.problems += problems
        if len(same) < len(samples):
            found.problems.append(f"{template.pattern}: files of different types in one pattern")
    else:
        _add_other(found, template, problems)


def _add_bare(found: Examination, template: Template) -> None:
    """Tell files of bare numbers as images, where they are as large as the others."""
    sizes = {plane.samples[0].size: None for plane in found.planes if plane.raw is None}
    paths = [found.survey.root / member.path for member in some_of(template.members)]
    raw = bare_layout(paths, sizes)
    samples = [] if raw is None else bare_samples(paths, raw)
    if samples:
        guess = guessed(template.pattern, samples)
        guess = replace(guess, evidence=(*guess.evidence, "bare numbers, as many as pixels"))
        found.planes.append(Plane(template, tuple(samples), guess, raw=raw))
        for others in (found.others, found.clouds):
            if template in others:
                others.remove(template)


def _add_arrays(found: Examination, template: Template) -> bool:
    """Add the arrays of containers as images; False = there are none, or it cannot be told."""
    paths = _paths(found.survey.root, template)
    try:
        arrays = arrays_in(paths[0])
    except DecodeError as error:
        found.problems.append(" ".join(str(error).replace(f"{found.survey.root}/", "").split()))
        return False
    if len(paths) == 1 and any(held.frames for held in arrays):
        name = template.members[0].name
        template = replace(template, prefix=name, suffix="", fixed=True)
    count = len(found.planes)
    for held in arrays[:12]:
        samples = samples_of(paths, held)
        if samples:
            name = f"{template.pattern.rpartition('.')[0]}/{held.key}.array"
            guess = guessed(name if held.key else template.pattern, samples)
            found.planes.append(Plane(template, tuple(samples), guess, held))
    return len(found.planes) > count


def _kind_of(samples: Iterable[Sample]) -> tuple[int, np.dtype[np.generic]]:
    kinds = [(sample.channels, sample.pixels.dtype) for sample in samples]
    return max(kinds, key=kinds.count)


def _add_other(found: Examination, template: Template, problems: Iterable[str] = ()) -> None:
    path = found.survey.root / template.members[0].path
    try:
        holding = holding_at(path)
    except DecodeError as error:
        root = found.survey.root
        found.problems.append(" ".join(str(error).replace(f"{root}/", "").split()))
        return
    if holding is not None:
        if holding.kind == "points":
            found.clouds.append(template)
        else:
            found.holdings.append(holding)
        return
    found.problems += problems
    if template.ending in ENDINGS or template.ending in (".lst", ""):
        calibration = calibration_in(path)
        named = has_words(template.pattern, Kind.CAMERA) or template.ending in (".yaml", ".yml")
        if named and (calibration is None or "fx" not in calibration.numbers):
            calibration = calibration_by_reader(path) or calibration
        if calibration is not None and _may_be_camera(template, calibration):
            found.cameras.append(CameraFiles(template, calibration))
        else:
            found.texts.append(template)
    elif (
        template.ending == ".bin" and not has_words(template.pattern, Kind.DEPTH) and _is_scan(path)
    ):
        found.clouds.append(template)
    else:
        found.others.append(template)


def _may_be_camera(template: Template, calibration: Calibration) -> bool:
    return bool(calibration.numbers) or calibration.depth_scale is not None


def _is_scan(path: Path) -> bool:
    """Tell whether a file is bare float32 points, x y z and one or two numbers more."""
    size = path.stat().st_size
    if size == 0 or (size % 16 and size % 20):
        return False
    try:
        start = read_start(path, 8000)
    except DecodeError:
        return False
    values = np.frombuffer(start[: len(start) // 4 * 4], np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        fits = np.isfinite(values) & (np.abs(values) < 5000)
    tiny = (np.abs(values) < 1e-6) & (values != 0)
    return bool(fits.all() and not tiny.any())


def named_by_role(template: Template) -> bool:
    """Tell whether a pattern's innermost folder or names say what it holds."""
    return has_role(template.folder.rstrip("/").rpartition("/")[2]) or has_role(template.prefix)
