"""What a network is given: the paper's setups by name, or modalities of one's own choice."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES, modality_name
from nimprep.torch.views import VIEWS

CHANNELS: dict[str, int] = {
    name: modality.channel_count
    for name, modality in MODALITIES.items()
    if modality.values != "classes"
} | {name: view.channels for name, view in VIEWS.items()}
"""Channels that each modality, and each view of one, gives a network."""


def channels_of(name: str) -> int:
    """Return the channels of a modality, a view of one, or a plane, which has one."""
    return CHANNELS.get(name, 1)


Setup = Literal[
    "rgb",
    "depth",
    "hha",
    "rgb+d",
    "rgb+hha",
    "nim-depth",
    "nim-rgb+d",
    "disparity",
    "t-disparity",
    "elevation",
    "rgb+disparity",
    "rgb+t-disparity",
    "rgb+elevation",
    "depth3",
    "depth+mask",
    "depth-minmax",
    "tdisp",
    "rgb+depth3",
    "rgb+depth-minmax",
    "rgb+tdisp",
]

SETUPS: dict[Setup, tuple[str, ...]] = {
    "rgb": ("rgb",),
    "depth": ("depth",),
    "hha": ("hha",),
    "rgb+d": ("rgb", "depth"),
    "rgb+hha": ("rgb", "hha"),
    "nim-depth": ("normal",),
    "nim-rgb+d": ("rgb", "normal"),
    "disparity": ("disparity",),
    "t-disparity": ("transformed_disparity",),
    "elevation": ("elevation",),
    "rgb+disparity": ("rgb", "disparity"),
    "rgb+t-disparity": ("rgb", "transformed_disparity"),
    "rgb+elevation": ("rgb", "elevation"),
    "depth3": ("depth3",),
    "depth+mask": ("depth", "mask"),
    "depth-minmax": ("depth-minmax",),
    "tdisp": ("transformed_disparity",),
    "rgb+depth3": ("rgb", "depth3"),
    "rgb+depth-minmax": ("rgb", "depth-minmax"),
    "rgb+tdisp": ("rgb", "transformed_disparity"),
}
"""The papers' setups: which modalities, in the order of their channels.

"nim-" stands for the normals in place of the depth. Those of two modalities serve data fusion too.
The first seven are the first paper's, the next six the second's, which has rgb, normals and HHA
too; the last seven are what other networks take, see `VIEWS`, and short names.

Sources: Wang et al., "Applying surface normal information in drivable area and road anomaly
detection for ground mobile robots", IROS 2020, tables I and II. Wang et al., "Dynamic fusion module
evolves drivable area and road anomaly detection: a benchmark and algorithms", IEEE Transactions on
Cybernetics 52, 2022.
"""


@dataclass(frozen=True)
class Selection:
    """Say which tensors a sample has.

    Attributes
    ----------
    images : tuple of str
        Modalities, and views of them, that become float tensors, in order.
    label : bool
        Whether there is a label.
    inputs : tuple of tuple of str
        The modalities of each tensor in "inputs"; two or more where they are fused. Empty: one
        tensor per name in place of "inputs".
    """

    images: tuple[str, ...]
    label: bool
    inputs: tuple[tuple[str, ...], ...]

    @property
    def modalities(self) -> tuple[str, ...]:
        """The modalities that the images are, or are made of; each once, in order."""
        return tuple(dict.fromkeys(VIEWS[n].of if n in VIEWS else n for n in self.images))

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """What each tensor is made of: those in "inputs", or one per image."""
        return self.inputs or tuple((name,) for name in self.images)

    @property
    def channels(self) -> tuple[int, ...]:
        """Channels of each tensor in "inputs", or of each image where there are none."""
        return tuple(sum(channels_of(name) for name in group) for group in self.groups)


def select(
    setup: Setup | tuple[str, ...] | None,
    *,
    fusion: bool = False,
    modalities: Sequence[str] | None = None,
    planes: Collection[str] = (),
) -> Selection:
    """Return what a setup, or a choice of modalities, puts into a sample.

    Parameters
    ----------
    setup : str or tuple of str, optional
        One of `SETUPS`, or any mix of modalities, views, planes and setups: ("rgb", "elevation",
        "thermal"), or as one text "rgb+elevation+thermal", which type checkers do not know.
    fusion : bool
        A tensor for each modality of a setup or of `modalities`; of a tuple for each entry, which
        may be several joined by "+": ("rgb", "normal+elevation").
    planes : collection of str
        The names of the store's own, which `modalities` may have too, and setups of several parts.

    Raises
    ------
    ArrayError
        The setup or a modality is unknown or named twice; both or neither are given; there is
        nothing to fuse.
    """
    if (setup is None) == (modalities is None):
        raise ArrayError(
            f"setup: expected either a setup or modalities, found {setup!r} and {modalities!r}; "
            f"setups are {', '.join(SETUPS)}"
        )
    if modalities is not None:
        return _own_mix(modalities, fusion, planes)
    groups = _groups(setup or (), planes)
    names = tuple(name for group in groups for name in group)
    if not fusion:
        return Selection(names, True, (names,))
    if len(groups) < 2:
        pairs = ", ".join(name for name, parts in SETUPS.items() if len(parts) == 2)
        raise ArrayError(
            f"fusion: expected a setup of two modalities ({pairs}) or more, found {setup!r}; name "
            "what to fuse it with"
        )
    return Selection(names, True, groups)


def _groups(setup: str | Sequence[str], planes: Collection[str]) -> tuple[tuple[str, ...], ...]:
    """Return the modalities of each tensor that a setup is fused from."""
    known: Mapping[str, tuple[str, ...]] = {str(name): names for name, names in SETUPS.items()}
    text = setup if isinstance(setup, str) else "+".join(map(str, setup))
    entries = (text,) if isinstance(setup, str) or text in known else tuple(map(str, setup))
    single = {name: names for name, names in known.items() if len(names) == 1}
    single |= {name: (name,) for name in CHANNELS} | {"d": ("depth",)}
    single |= {name: (name,) for name in planes}
    groups = []
    for entry in entries:
        parts = [single.get(p) or single.get(modality_name(p), ("",)) for p in entry.split("+")]
        groups.append(known.get(entry) or tuple(name for part in parts for name in part))
    names = [name for group in groups for name in group]
    if "" in names or not names or len(set(names)) < len(names):
        mix = ", ".join(dict.fromkeys((*CHANNELS, *planes)))
        raise ArrayError(
            f"setup: expected one of {', '.join(SETUPS)}, or a mix of {mix}, each once, as in "
            f"'rgb+{next(iter(planes), 'elevation')}', found {setup!r}"
        )
    return tuple((name,) for name in groups[0]) if len(groups) == 1 else tuple(groups)


def _own_mix(modalities: Sequence[str], fusion: bool, planes: Collection[str]) -> Selection:
    names = (modalities,) if isinstance(modalities, str) else tuple(modalities)
    known = (*MODALITIES, *VIEWS, *planes)
    unknown = [name for name in names if name not in known]
    if unknown or not names or len(set(names)) < len(names):
        raise ArrayError(
            f"modalities: expected some of {', '.join(known)}, each once, found {names!r}"
        )
    images = tuple(name for name in names if name in CHANNELS or name in planes)
    if fusion and len(images) < 2:
        raise ArrayError(
            f"fusion: expected two modalities or more beside a label, found {names!r}; name what "
            "to fuse it with"
        )
    return Selection(images, "label" in names, tuple((name,) for name in images) if fusion else ())


def check_dtype(dtype: str, selection: Selection, transform: object) -> None:
    """Raise `ArrayError` for a dtype that a dataset cannot have."""
    if dtype not in ("float32", "stored"):
        raise ArrayError(f"dtype: expected 'float32' or 'stored', found {dtype!r}")
    if dtype == "stored" and transform is not None:
        raise ArrayError("dtype: expected 'float32' with a transform, found 'stored'")
    made = [name for name in selection.images if name in VIEWS]
    if dtype == "stored" and made:
        raise ArrayError(f"dtype: expected 'float32' with {made[0]}, found 'stored'")
