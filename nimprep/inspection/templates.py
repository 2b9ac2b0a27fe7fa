"""Files by pattern: what varies in their paths becomes placeholders."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

from nimprep.inspection.stems import MIXED, VIEW, affixes, name_key
from nimprep.inspection.words import has_role, words_of
from nimprep.readers.split_lists import CALLED

_CAMERA = re.compile(r"(cam(era)?[_\-. ]?\d+|left|right)/", re.IGNORECASE)

_MANY = 12
"""So many sibling folders of one shape are scenes, whatever their names."""


@dataclass(frozen=True)
class Member:
    """Name a file and what the placeholders for folders stand for in its path."""

    path: str
    captured: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.path.rpartition("/")[2]

    @property
    def stem(self) -> str:
        return self.name.rpartition(".")[0] or self.name


@dataclass(frozen=True)
class Template:
    """Hold files whose paths have one shape.

    Attributes
    ----------
    folder : str
        With placeholders, ends in "/" unless empty.
    prefix, suffix : str
        What all names begin and end with, the ending ".png" or the like included.
    members : tuple of Member
    fixed : bool
        All have the one name `prefix`.
    """

    folder: str
    prefix: str
    suffix: str
    members: tuple[Member, ...]
    fixed: bool = False

    @property
    def pattern(self) -> str:
        middle = "" if self.fixed else "{id}"
        if "{id}" in self.folder and not self.fixed:
            middle = "*"
        return f"{self.folder}{self.prefix}{middle}{self.suffix}"

    @property
    def ending(self) -> str:
        name = self.members[0].name
        return name[name.rfind(".") :].lower() if "." in name[1:] else ""


class _Folder:
    """A folder with what lies in it."""

    def __init__(self, path: str = "") -> None:
        self.path = path
        self.folders: dict[str, _Folder] = {}
        self.files: list[str] = []


def templates_of(files: Iterable[str], look: Callable[[str], str]) -> list[Template]:
    """Return files by pattern.

    Parameters
    ----------
    files : iterable of str
        Paths with "/".
    look : callable
        Path to what the file's first bytes say it is: folders whose files differ in it are not
        scenes of one dataset.
    """
    root = _Folder()
    for path in files:
        place = root
        *folders, name = path.split("/")
        for folder in folders:
            if folder not in place.folders:
                place.folders[folder] = _Folder(f"{place.path}{folder}/")
            place = place.folders[folder]
        place.files.append(name)
    found: list[Template] = []
    _visit([(root, {})], "", found, cache(look))
    return _joined(found)


def _visit(
    places: list[tuple[_Folder, dict[str, str]]],
    pattern: str,
    found: list[Template],
    look: Callable[[str], str],
) -> None:
    """Add the templates of folders that are alike, and of those in them."""
    _add_files(places, pattern, found)
    children: dict[str, list[tuple[_Folder, dict[str, str]]]] = {}
    for folder, captured in places:
        for name, child in folder.folders.items():
            children.setdefault(name, []).append((child, captured))
    for names, placeholder in _classes(children, pattern, look):
        if not placeholder:
            _visit(children[names[0]], f"{pattern}{names[0]}/", found, look)
            continue
        # Camera_0 and Camera_1 are cameras 0 and 1, as tables call them too.
        head = _camera_head(names) if placeholder.startswith("camera") else ""
        inner = [
            (child, {**captured, placeholder: name[len(head) :]})
            for name in names
            for child, captured in children[name]
        ]
        _visit(inner, f"{pattern}{head}{{{placeholder}}}/", found, look)


def _classes(
    children: Mapping[str, list[tuple[_Folder, dict[str, str]]]],
    pattern: str,
    look: Callable[[str], str],
) -> list[tuple[list[str], str]]:
    """Return folders' names, those of scenes of one dataset together, with their placeholder."""
    split = [name for name in children if name.lower() in CALLED]
    classes: list[tuple[list[str], set[str]]] = []
    literal: list[list[str]] = []
    roles = [name for name in children if has_role(name) and name not in split]
    cameras = [name for name in roles if re.match(r"cam(era)?[_\-. ]?\d+$", name.lower())]
    for name in children:
        if name in split:
            continue
        signature = set().union(*(_signature(child, look) for child, _ in children[name]))
        whole = sum(part.endswith("/") and not _CAMERA.match(part) for part in signature) > 1
        if name in roles and len(roles) <= _MANY and not whole and len(cameras) < 2:
            literal.append([name])
            continue
        for names, known in classes:
            if len(signature & known) >= 0.5 * max(1, min(len(signature), len(known))):
                names.append(name)
                known |= signature
                break
        else:
            classes.append(([name], signature))
    made = [(names, "") for names in literal]
    if split:
        made.append((split, _free("split", pattern)))
    for names, _ in classes:
        scenes = len(names) > 1 or re.search(r"\d\d", names[0])
        made.append((names, _placeholder(names, pattern) if scenes else ""))
    return made


def _camera_head(names: Sequence[str]) -> str:
    """Return what all names begin with before a number; "" where some have none."""
    match = re.match(r"\D+(?=\d)", names[0])
    head = match[0] if match else ""
    return head if all(re.fullmatch(rf"{re.escape(head)}\d+", name) for name in names) else ""


def _signature(folder: _Folder, look: Callable[[str], str]) -> set[str]:
    """Return what a folder has in it, down to folders whose names say what they hold."""
    firsts: dict[tuple[str, ...], str] = {}
    for name in folder.files[:100]:
        firsts.setdefault(name_key(name), name)
    found = {f"{key} {look(folder.path + name)}" for key, name in firsts.items()}
    for name, child in list(folder.folders.items())[:100]:
        found |= {f"{name}/"} if has_role(name) else _signature(child, look)
    return found


def _placeholder(names: Sequence[str], pattern: str) -> str:
    if all(words_of(name)[:1] in (("camera",), ("cam",)) for name in names):
        return _free("camera", pattern)
    return _free("scene", pattern)


def _free(name: str, pattern: str) -> str:
    count = 2
    free = name
    while f"{{{free}}}" in pattern:
        free, count = f"{name}{count}", count + 1
    return free


def _add_files(
    places: list[tuple[_Folder, dict[str, str]]], pattern: str, found: list[Template]
) -> None:
    by_key: dict[tuple[str, ...], list[Member]] = {}
    for folder, captured in places:
        for name in folder.files:
            by_key.setdefault(name_key(name), []).append(Member(folder.path + name, captured))
    for key in list(by_key):
        for other in list(by_key):
            if key != other and key in by_key and _goes_with(key, other, by_key):
                by_key[key] += by_key.pop(other)
    found += [_template(pattern, members) for members in by_key.values()]


def _template(folder: str, members: list[Member]) -> Template:
    stems = {member.stem for member in members}
    name = members[0].name
    ending = name[len(members[0].stem) :]
    if len({member.name[len(member.stem) :].lower() for member in members}) > 1:
        ending = ".*"
    stem = members[0].stem
    told = VIEW.match(stem) or not re.search(r"\d", stem)
    if len(stems) == 1 and (told or len(members) > 1):
        return Template(folder, stem + ending, "", tuple(members), fixed=True)
    head, tail = affixes(sorted(stems))
    return Template(folder, head, tail + ending, tuple(members))


def _joined(found: list[Template]) -> list[Template]:
    """Join templates of one dataset whose scenes lie at different depths."""
    by_tail: dict[tuple[str, str, str], list[Template]] = {}
    for template in found:
        tail = _tail(template.folder)
        name = template.prefix if template.fixed else ""
        by_tail.setdefault((tail, name, template.ending), []).append(template)
    joined: list[Template] = []
    for (tail, name, ending), some in by_tail.items():
        depths = {template.folder.count("/") for template in some}
        if len(depths) == 1 or not any(t.folder.startswith("{") for t in some):
            joined += some
            continue
        members = tuple(
            Member(member.path, {"id": member.path[: -len(tail) - len(member.name) - 1]})
            for template in some
            for member in template.members
        )
        same = all(template.fixed for template in some)
        joined.append(
            Template("{id}/" + tail, name, "", members, fixed=True)
            if same
            else Template("{id}/" + tail, "", ending, members)
        )
    return joined


def _tail(folder: str) -> str:
    """Return a folder's path from its first part on whose name says what it holds."""
    parts = folder.split("/")[:-1]
    while parts and not has_role(parts[0]):
        parts.pop(0)
    return "".join(f"{part}/" for part in parts)


def _goes_with(
    key: tuple[str, ...], other: tuple[str, ...], by_key: Mapping[tuple[str, ...], list[Member]]
) -> bool:
    """Tell whether files of two endings are one kind of image, as of phones and downloads."""
    if key[1:] != other[1:] or not {key[0], other[0]} <= MIXED:
        return False
    places = [{m.path.rpartition(".")[0] for m in by_key[name]} for name in (key, other)]
    return not places[0] & places[1]
