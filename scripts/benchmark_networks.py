"""Count what each network costs, and time it against MFNet on this machine.

    python scripts/benchmark_networks.py                 # the table of docs/networks.md
    python scripts/benchmark_networks.py --counts        # parameters and operations alone
    python scripts/benchmark_networks.py --networks rtfnet18,espnet --size 96 128 --rounds 1

Prints a table in Markdown: parameters, operations (two for each multiply-add) at 480x640 for three
classes in the nim-rgb+d setup, and how many times MFNet's time one image in evaluation and one
training step (forward, loss, backward, SGD) take. Each network is timed in turns with MFNet, the
smallest time of the rounds counts, and what MFNet took is said below. On a machine that others use
``--busy`` counts the processor time of one thread in place of the time that passes.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from nimprep.networks import NETWORKS, Network, build_network, count_parameters

CLASSES = 3
REFERENCE = "mfnet"
COUNTED = (480, 640)


def made(name: str, width: float = 1.0) -> Network:
    """Return a network of the nim-rgb+d setup."""
    return build_network(name, (3, 3) if NETWORKS[name].fusion else 6, CLASSES, width)


def counts(name: str) -> str:
    """Return parameters and operations as cells of a row; no weight is drawn for it."""
    with torch.device("meta"):
        network = made(name)
    return f"{count_parameters(network):,} | {network.flops(*COUNTED) / 1e9:.1f}"


def arguments(network: Network, options: argparse.Namespace) -> list[Tensor]:
    """Return a batch of noise that a network takes."""
    channels = (network.inputs,) if isinstance(network.inputs, int) else network.inputs
    given = (*channels, 1) if network.wants_canny or network.wants_depth else channels
    return [torch.rand(options.batch, n, *options.size) for n in given]


def runs(name: str, options: argparse.Namespace) -> dict[str, Callable[[], object]]:
    """Return what is timed of a network, by its name."""
    network = made(name, options.width)
    images = arguments(network, options)
    labels = torch.randint(0, CLASSES, (options.batch, *options.size))
    optimizer = torch.optim.SGD(network.parameters(), 1e-4, momentum=0.9)

    def infer() -> None:
        network.eval()
        with torch.inference_mode():
            network(*(image[:1] for image in images))

    def train() -> None:
        network.train()
        optimizer.zero_grad()
        network.loss(network(*images), labels).backward()
        optimizer.step()

    return {"inference": infer, "training": train}


def seconds(run: Callable[[], object], busy: bool) -> float:
    """Return how long one call takes."""
    clock = time.process_time if busy else time.perf_counter
    begin = clock()
    run()
    return clock() - begin


def ratios(name: str, options: argparse.Namespace) -> tuple[list[float], list[float]]:
    """Return a network's times over MFNet's, and MFNet's in seconds."""
    other, reference = runs(name, options), runs(REFERENCE, options)
    best: dict[tuple[str, bool], float] = {}
    for place in range(options.rounds + 1):
        for kind in other:
            for own, run in ((True, other[kind]), (False, reference[kind])):
                took = seconds(run, options.busy)
                if place:  # the first is to warm up
                    best[kind, own] = min(took, best.get((kind, own), took))
    base = [best[kind, False] for kind in other]
    return [best[kind, True] / b for kind, b in zip(other, base, strict=True)], base


def main(given: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--networks", default=",".join(NETWORKS), help="names, by commas")
    parser.add_argument("--counts", action="store_true", help="time nothing")
    parser.add_argument("--size", type=int, nargs=2, default=(240, 320), metavar=("H", "W"))
    parser.add_argument("--batch", type=int, default=4, help="of a training step")
    parser.add_argument("--width", type=float, default=1.0, help="as build_network takes it")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--busy", action="store_true", help="processor time of one thread")
    options = parser.parse_args(given)
    if options.busy:
        torch.set_num_threads(1)
    timed = "" if options.counts else " inference | training |"
    print(f"| network | parameters | GFLOPs |{timed}")
    print("| --- | ---: | ---: |" + " ---: |" * timed.count("|"))
    base: list[float] = []
    for name in options.networks.split(","):
        row = f"| {name} | {counts(name)} |"
        if not options.counts:
            found, base = ratios(name, options)
            row += "".join(f" {ratio:.2g} |" for ratio in found)
        print(row, flush=True)
    if base:
        height, width = options.size
        clock = "processor time" if options.busy else "time that passed"
        print(
            f"\n{REFERENCE}: {base[0]:.3f} s an image of {height}x{width}, {base[1]:.3f} s a "
            f"training step of {options.batch}; {clock}, {torch.get_num_threads()} threads, load "
            f"{os.getloadavg()[0]:.1f}, PyTorch {torch.__version__}, width {options.width:g}"
        )


if __name__ == "__main__":
    main()
