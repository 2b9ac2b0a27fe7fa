"""Whatever names data hold, no command lets them steer the terminal they are shown on."""

from __future__ import annotations

import ast
import io
import json
import shutil
import sys
from pathlib import Path

import pytest

import nimprep
from nimprep.cli.echo import echo
from nimprep.cli.options import progress_bars
from nimprep.report.server import ViewServer
from nimprep.store.metadata import read_attributes, write_attributes
from nimprep.text import printable
from tests.checksums import renew_checksums
from tests.cli.world import CALLS, EVERY, Call, commands, make_world, run
from tests.hostile.stores import table, table_file

HOSTILE = "\x1b]0;owned\x07\x1b[1m\x9b2J\r\u202e\x7f\n<script>owned"

PLAIN = r"\x1b]0;owned\x07\x1b[1m\x9b2J\r\u202e\x7f\n<script>owned"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a world whose datasets, stores and folders have hostile names."""
    root = tmp_path_factory.mktemp("terminal") / HOSTILE
    make_world(root, (f"0{HOSTILE}", f"1{HOSTILE}"), HOSTILE)
    for name in ("s.zarr", "t.zarr"):
        spoil(root / name)
    return root


def spoil(store: Path) -> None:
    """Put the text wherever a store takes one and commands still work."""
    found = read_attributes(store)
    found["tool_version"] = HOSTILE
    found["frame_metadata"] = {"depth_source": {"values": [HOSTILE], "of_frame": [0, 0, 0]}}
    found["skipped"] = [{"id": HOSTILE, "reason": HOSTILE}]
    write_attributes(store, found)
    (store / table_file("group")).write_bytes(table([HOSTILE, HOSTILE, f"{HOSTILE}2"]))
    renew_checksums(store, chunks=False)


@pytest.fixture
def world(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / HOSTILE))


def harmless(text: str) -> bool:
    """Return whether a terminal shows a text as it is, and no name begins a line of its own."""
    letters = all(letter.isprintable() or letter == "\n" for letter in text)
    return letters and "\n<script>" not in text


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nimprep.cli.synth.DEMO_FRAMES", 1)
    monkeypatch.setattr(ViewServer, "run", lambda self: None)


def test_the_text_is_hostile() -> None:
    assert not harmless(HOSTILE)
    assert printable(HOSTILE) == PLAIN
    assert printable("ä日 \\ \ud800", lines=True) == "ä日 \\ \\ud800"


def test_every_command_is_tried() -> None:
    assert CALLS.keys() == {name for name, _ in commands()}


@pytest.mark.parametrize("call", EVERY, ids=str)
def test_no_name_steers_a_terminal_when_a_command_goes_well(world: Path, call: Call) -> None:
    result = run(call.at(world))
    # A store that was tampered with may be called so.
    assert result.exit_code == 0 or call.arguments[0] == "validate", result.output
    assert harmless(result.stdout)
    assert harmless(result.stderr)
    for page in (path for path in world.glob("new") if path.is_file()):
        assert b"<script>owned" not in page.read_bytes()


@pytest.mark.parametrize("call", EVERY, ids=str)
def test_no_name_steers_a_terminal_when_nothing_is_there(tmp_path: Path, call: Call) -> None:
    result = run(call.at(tmp_path / HOSTILE / "none"))
    assert result.exit_code == (0 if call.arguments[0] in ("synth", "demo", "warm-up") else 1)
    assert harmless(result.stdout)
    assert harmless(result.stderr)
    assert result.stderr.count("\n") <= 1


@pytest.mark.parametrize("command", [name.split() for name in CALLS], ids=" ".join)
def test_no_wrong_argument_steers_a_terminal(command: list[str]) -> None:
    for wrong in ([f"--{HOSTILE}"], [f"--quiet={HOSTILE}"], [HOSTILE] * 9):
        result = run([*command, *wrong])
        assert result.exit_code in (1, 2)
        assert harmless(result.output.replace("\n\t", "\n"))  # click's list of choices
    assert harmless(run([HOSTILE]).output)
    assert harmless(run([f"--{HOSTILE}", *command]).output)


def test_no_skipped_frame_and_no_warning_steers_a_terminal(world: Path) -> None:
    (world / "raw" / "depth" / "a" / "1.png").write_bytes(b"spoilt")
    document = json.loads((world / "raw.json").read_text())
    del document["camera"]
    (world / "raw.json").write_text(json.dumps(document))
    result = run([*CALLS["convert"][0].at(world), "--on-error", "skip"])
    assert result.exit_code == 1
    assert "skipped a/1: " in result.stderr
    assert "warning: " in result.stderr
    assert PLAIN in result.stderr
    assert harmless(result.output)


def test_no_method_steers_a_terminal(world: Path) -> None:
    call = ["evaluate", str(world / "s.zarr")]
    for form in ("text", "json", "markdown", "latex"):
        methods = (f"{HOSTILE}{name}={world / name}" for name in ("predictions", "others"))
        result = run([*call, *methods, "--format", form])
        assert result.exit_code == 0
        assert harmless(result.output)


def test_no_step_steers_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    stderr = io.StringIO()
    stderr.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", stderr)
    done = progress_bars(quiet=False)(HOSTILE, 1)
    done()
    assert PLAIN in stderr.getvalue()
    assert "owned\x07" not in stderr.getvalue()


def test_bold_letters_are_let_through_where_they_are_meant(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for bold in (False, True):
        echo("\x1b[1mbest\x1b[0m \x1b[31m", bold=bold)
        shown = capsys.readouterr().out
        # No terminal: click takes the codes away.
        assert shown == ("best \\x1b[31m\n" if bold else "\\x1b[1mbest\\x1b[0m \\x1b[31m\n")


def test_commands_print_by_echo_alone() -> None:
    folder = Path(nimprep.__file__).parent
    for path in folder.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        found = {
            ast.unparse(node.func)
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Call)
        }
        if path != folder / "cli" / "echo.py":
            assert not found & {"click.echo", "click.secho", "print"}, path
