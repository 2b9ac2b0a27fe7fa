"""Check the types of the pages' Python examples with pyright, as their readers' editors do.

    python scripts/check_examples.py    # needs pyright: pip install 'pyright[nodejs]'

Each block of Python in README.md and docs/*.md is a module of its own, after names that its page
takes as given. Blocks whose title has a folder are files of the package, which mypy checks.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"^```python(?: title=\"[^/\"]*\")?\n(.*?)^```", re.M | re.S)
GIVEN = {
    "nimprep": "import nimprep",
    "depth_m": "depth_m = np.ones((4, 6), np.float32)",
    "C": "C = np.eye(3)",
    "D": "D = np.ones((4, 6), np.float32)",
    "RD": "RD = np.ones((4, 6), np.float32)",
    "store": 'store = nimprep.open_store("out.zarr")',
    "frame": "frame = store[0]",
    "network": "import torch\nnetwork = torch.nn.Bilinear(3, 3, 2)",
}
"""Names that examples use without saying where they come from."""


def module_of(block: str) -> str:
    """Return a block with what it takes as given before it."""
    words = set(re.findall(r"\w+", block))
    made = set(re.findall(r"^(?:import )?(\w+)(?: =|$)", block, re.M))
    needed = words - made
    if "frame" in needed:
        needed.add("store")
    given = [line for name, line in GIVEN.items() if name in needed]
    return "\n".join(["import numpy as np", *given, "", block])


def main() -> int:
    """Check every example; return pyright's exit code."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    with tempfile.TemporaryDirectory() as folder:
        count = 0
        for page in pages:
            for number, block in enumerate(BLOCK.findall(page.read_text()), 1):
                path = Path(folder, f"{page.stem.replace('-', '_')}_{number}.py")
                path.write_text(module_of(block))
                count += 1
        if count == 0:
            sys.exit("expected examples in the pages, found none")
        print(f"{count} examples")
        command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, folder]
        return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
