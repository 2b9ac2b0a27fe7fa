"""The examples of docs/networks.md run, and its table of networks is what they are."""

import re
from pathlib import Path
from typing import Any

from nimprep.networks import NETWORKS
from tests.networks.test_networks import made

PAGE = Path(__file__).parent.parent.parent / "docs" / "networks.md"


def test_the_pages_examples_run() -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    assert len(blocks) == 2
    for block in blocks:
        assert "480, 640" in block
        found: dict[str, Any] = {}
        exec(block.replace("480, 640", "64, 96"), found)
        assert found["logits"].shape == (1, 3, 64, 96)


def test_the_page_says_what_each_network_takes() -> None:
    rows = re.findall(r"^\| `(\w+)`[^|]*\| (one|two)[^|]*\| ([\w ]+) \|", PAGE.read_text(), re.M)
    assert {name for name, _, _ in rows} == {n for n in NETWORKS if n[:6] != "rtfnet"} | {
        "rtfnet18"
    }
    for name, images, divisor in rows:
        network = made(name)
        assert (images == "two") == NETWORKS[name].fusion
        assert divisor == ("any size" if network.divisor == 1 else str(network.divisor))
