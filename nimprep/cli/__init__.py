"""The command line: options, progress and exit codes; everything else is imported when needed."""

from __future__ import annotations

import errno
import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import click

from nimprep import __version__
from nimprep.cli.echo import echo
from nimprep.errors import NimprepError, OptionError
from nimprep.text import printable

_COMMANDS = {
    "inspect": ("nimprep.cli.inspect", "Say what raw data is, and write a description of it."),
    "convert": ("nimprep.cli.convert", "Turn a raw dataset into a store."),
    "append": ("nimprep.cli.append", "Add a raw dataset's frames to a store of its kind."),
    "merge": ("nimprep.cli.merge", "Join stores of one kind into a new one."),
    "info": ("nimprep.cli.info", "Show what a store holds."),
    "validate": ("nimprep.cli.info", "Check a store; exit 1 where something is wrong."),
    "split": ("nimprep.cli.split", "Show, export or change who is train, val and test."),
    "train": ("nimprep.cli.train", "Train a network on a store."),
    "predict": ("nimprep.cli.predict", "Predict frames of a store by a trained network."),
    "evaluate": ("nimprep.cli.evaluate", "Score predicted labels against a store."),
    "export": ("nimprep.cli.export", "Write frames as PNGs, NumPy archives or a Rerun recording."),
    "report": ("nimprep.cli.report", "Show a store on one page of HTML that needs no network."),
    "view": ("nimprep.cli.view", "Browse every frame of a store in the browser, on this machine."),
    "synth": ("nimprep.cli.synth", "Make a synthetic dataset in GMRP's layout."),
    "demo": ("nimprep.cli.synth", "Try it all on data made on the spot."),
    "warm-up": ("nimprep.cli.warmup", "Compile every kernel now, as when an image is built."),
    "kitti": ("nimprep.cli.kitti", "KITTI road: depth, bird's-eye view, scores, submission."),
}
"""Each command's module, imported when it is called, and its line in the help."""


class _LazyGroup(click.Group):
    """Import a command's module only when it is called, and print data errors as one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(_COMMANDS[cmd_name][0])
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        from difflib import get_close_matches

        if args[0] not in _COMMANDS and (meant := get_close_matches(args[0], _COMMANDS, 1)):
            ctx.fail(f"No such command '{args[0]}'. Did you mean '{meant[0]}'?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])

    def main(self, *args: Any, **named: Any) -> Any:
        try:
            return super().main(*args, **named)
        except OSError as error:
            # click takes a closed pipe for the reader's wish.
            if error.errno == errno.EPIPE or not _while_printing(error):
                raise
            # Or Python tries once more at its end, and says so.
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            fail(f"standard output: expected room for the result, found {error.strerror}")

    def make_context(self, *args: Any, **named: Any) -> click.Context:
        with _clean_usage():
            return super().make_context(*args, **named)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with _clean_usage(), warnings.catch_warnings():
                warnings.simplefilter("default", UserWarning)
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except OptionError as error:
            fail(str(error), 2)
        except NimprepError as error:
            fail("; ".join((str(error), *getattr(error, "__notes__", ()))))
        except FileNotFoundError:
            if not _directory_is_gone():
                raise
            fail("working directory: expected one that is there, found it deleted; change to one")
        except KeyboardInterrupt as error:
            notes = getattr(error, "__notes__", ())
            echo("; ".join(("interrupted", *notes)), err=True)
            sys.exit(130)


@contextmanager
def _clean_usage() -> Iterator[None]:
    """Let what click says of a wrong call, which may be a file's name, steer no terminal."""
    try:
        yield
    except click.ClickException as error:
        click.ClickException.__init__(error, printable(error.message))
        raise


def _directory_is_gone() -> bool:
    """Tell whether the directory that relative paths start from was deleted."""
    try:
        Path.cwd()
    except FileNotFoundError:
        return True
    return False


def _while_printing(error: OSError) -> bool:
    """Tell whether printing failed, and no file of a command's."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return frames[-1].f_globals.get("__name__") == click.echo.__module__


def _show_warning(message: Warning | str, *rest: Any, **named: Any) -> None:
    echo(f"warning: {' '.join(str(message).split())}", err=True)


def fail(message: str, code: int = 1) -> NoReturn:
    """Print one line to stderr and exit 1: the data is bad; or 2: the call is wrong."""
    echo(f"error: {' '.join(message.split())}", err=True)
    sys.exit(code)


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, "--version", prog_name="nimprep")
def main() -> None:
    """Turn RGB-D road datasets into fast, checked multimodal Zarr stores."""
