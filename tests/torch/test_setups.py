import subprocess
import sys

import pytest

import nimprep.torch
from nimprep.errors import ArrayError
from nimprep.torch.setups import SETUPS, select


@pytest.mark.parametrize(
    ("setup", "channels"),
    [
        ("rgb", 3),
        ("depth", 1),
        ("hha", 3),
        ("rgb+d", 4),
        ("rgb+hha", 6),
        ("nim-depth", 3),
        ("nim-rgb+d", 6),
        ("disparity", 1),
        ("t-disparity", 1),
        ("elevation", 1),
        ("rgb+disparity", 4),
        ("rgb+t-disparity", 4),
        ("rgb+elevation", 4),
    ],
)
def test_a_setup_has_the_papers_channels(setup: str, channels: int) -> None:
    assert select(setup).channels == (channels,)


@pytest.mark.parametrize(
    ("setup", "channels"),
    [
        ("rgb+d", (3, 1)),
        ("rgb+hha", (3, 3)),
        ("nim-rgb+d", (3, 3)),
        ("rgb+disparity", (3, 1)),
        ("rgb+t-disparity", (3, 1)),
        ("rgb+elevation", (3, 1)),
    ],
)
def test_a_fused_setup_keeps_its_two_parts(setup: str, channels: tuple[int, int]) -> None:
    assert select(setup, fusion=True).channels == channels


def test_there_are_seven_setups_of_each_paper_or_six_and_seven_of_other_networks() -> None:
    assert len(SETUPS) == 7 + 6 + 7
    assert list(SETUPS)[:7] == ["rgb", "depth", "hha", "rgb+d", "rgb+hha", "nim-depth", "nim-rgb+d"]


def test_ones_own_mix_has_a_tensor_per_name() -> None:
    selection = select(None, modalities=("rgb", "label", "normal"))
    assert selection.images == ("rgb", "normal")
    assert selection.label
    assert selection.inputs == ()
    assert not select(None, modalities=["depth"]).label


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"setup": "rgbd"}, r"setup: expected one of rgb, .*nim-rgb\+d, .*found 'rgbd'"),
        ({"setup": "rgb", "fusion": True}, r"fusion: expected .*rgb\+d.*, found 'rgb'"),
        ({"setup": None}, "either a setup or modalities"),
        ({"setup": "rgb", "modalities": ("rgb",)}, "either a setup or modalities"),
        ({"setup": None, "modalities": ("rgb", "nomral")}, "modalities: expected some of rgb"),
        ({"setup": None, "modalities": ("rgb", "rgb")}, "each once"),
        ({"setup": None, "modalities": ()}, "modalities: expected some of"),
        ({"setup": None, "modalities": ("rgb", "label"), "fusion": True}, "two modalities or more"),
        ({"setup": ("rgb", "elevatoin")}, "found .*'elevatoin'"),
        ({"setup": ("rgb", "rgb+elevation")}, "each once"),
        ({"setup": ("elevation",), "fusion": True}, "what to fuse it with"),
        ({"setup": ()}, "setup: expected one of"),
    ],
)
def test_what_is_no_selection_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ArrayError, match=message):
        select(**arguments)


@pytest.mark.parametrize(
    ("setup", "names"),
    [
        (("rgb", "elevation"), ("rgb", "elevation")),
        (("elevation", "normal"), ("elevation", "normal")),
        ("rgb+normal+elevation", ("rgb", "normal", "elevation")),
        ("rgb+d+transformed-disparity", ("rgb", "depth", "transformed_disparity")),
        (("nim-rgb+d", "t-disparity", "mask"), ("rgb", "normal", "transformed_disparity", "mask")),
        (["depth-minmax", "hha", "disparity"], ("depth-minmax", "hha", "disparity")),
    ],
)
def test_a_setup_may_be_any_mix(setup: object, names: tuple[str, ...]) -> None:
    selection = select(setup)
    assert selection.images == names
    assert selection.inputs == (names,)
    assert selection.label


def test_a_mix_is_fused_from_its_entries() -> None:
    pair = select(("rgb", "normal+elevation"), fusion=True)
    assert pair.inputs == (("rgb",), ("normal", "elevation"))
    assert pair.channels == (3, 4)
    assert select("rgb+normal+elevation", fusion=True).channels == (3, 3, 1)
    # A text that is a setup is that setup, however it was put together.
    assert select(("nim-rgb", "d"), fusion=True) == select("nim-rgb+d", fusion=True)


def test_modalities_are_fused_each_by_itself_and_labelled_where_named() -> None:
    named = select(None, modalities=("rgb", "elevation", "label"), fusion=True)
    assert named.inputs == (("rgb",), ("elevation",))
    assert named.label
    assert not select(None, modalities=("rgb", "elevation"), fusion=True).label


def test_every_public_name_is_there() -> None:
    for name in nimprep.torch.__all__:
        assert getattr(nimprep.torch, name) is not None
        assert name in dir(nimprep.torch)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        nimprep.torch.nothing  # noqa: B018


def test_without_pytorch_the_error_says_how_to_get_it() -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from nimprep.errors import NimprepError\n"
        "try:\n    import nimprep.torch\n"
        "except NimprepError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("\n") == 1
    assert "pip install 'nimprep[torch]'" in done.stdout
