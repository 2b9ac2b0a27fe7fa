"""Nothing imports backwards or in a circle: each part may use those before it, and no other."""

import ast
import importlib
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import nimprep

PACKAGE = Path(nimprep.__file__).parent

LAYERS = [
    ["errors", "text", "compilation"],
    ["kernels", "folders"],
    [
        "files",
        "arrays",
        "depth",
        "depth_unit",
        "parallel",
        "options",
        "camera",
        "modality",
        "plane",
        "frame",
    ],
    ["schema", "schema_wording"],
    ["images", "splits", "metrics"],
    ["derive"],
    ["doubts"],
    ["kitti"],
    ["readers"],
    ["inspection"],
    ["store"],
    ["conversion"],
    ["report"],
    ["synthetic", "torch", "networks", "evaluation", "export"],
    ["training"],
    ["cli"],
    ["__main__"],
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}


def part(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def names_imported(path: Path) -> set[str]:
    """Return what a module imports of nimprep, by its full name.

    Anywhere: within functions, and for type checkers alone, too. What only a type checker imports
    makes no circle when it runs, but two files that cannot be read one after the other.
    """
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.startswith("nimprep.")}


def imported(path: Path) -> set[str]:
    """Return the parts of nimprep that a module imports."""
    return {name.split(".")[1] for name in names_imported(path)} - {"__version__"}


MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_no_two_files_import_each_other_in_a_circle() -> None:
    # The package itself, which only has its parts' public names, is no part.
    files = {module_name(path): path for path in MODULES}
    graph = {}
    for module, path in files.items():
        names = names_imported(path)
        # A name within a module comes with the module.
        found = {name if name in files else name.rpartition(".")[0] for name in names}
        graph[module] = found & files.keys() - {module}
    assert sum(map(len, graph.values())) > 500
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' <- '.join(error.args[1])}")


def test_every_part_has_its_layer() -> None:
    assert {part(path) for path in MODULES} == set(RANK)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_module_imports_backwards(path: Path) -> None:
    own = RANK[part(path)]
    # A name that is no part is a public name of the package, which is made of later layers.
    later = {
        name for name in imported(path) if RANK.get(name, len(LAYERS)) > own and name != part(path)
    }
    assert not later or own >= RANK["cli"], f"{path}: imports {sorted(later)} backwards"


def test_kernels_import_nothing_of_the_package_but_kernels_and_their_decorator() -> None:
    paths = sorted((PACKAGE / "kernels").glob("*.py"))
    assert len(paths) > 3
    for path in paths:
        tree = ast.parse(path.read_text())
        found = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        ours = [n for n in found if n.module and n.module.startswith("nimprep")]
        # What a kernel's cache depends on is told by these lines: see nimprep.compilation.cache.
        assert all(n in tree.body for n in ours), path
        for node in ours:
            module = node.module or ""
            assert module.startswith("nimprep.kernels.") or (
                module == "nimprep.compilation.decorator"
            ), path
            assert not any(name_of_module(module, alias.name) for alias in node.names), path
        plain = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
        assert not any(name.startswith("nimprep") for name in plain), path


def name_of_module(package: str, name: str) -> bool:
    return PACKAGE.parent.joinpath(*package.split("."), f"{name}.py").exists()


def test_loops_are_compiled_in_one_room() -> None:
    rooms = set()
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if any(re.match(r"numba\b|nimprep\.compilation\.decorator$", name) for name in names):
                rooms.add(part(path))
    assert rooms == {"compilation", "kernels"}


def test_what_a_kernel_writes_to_comes_last_in_its_call() -> None:
    writing = 0
    for path in sorted((PACKAGE / "kernels").glob("*.py")):
        for function in ast.parse(path.read_text()).body:
            if not isinstance(function, ast.FunctionDef) or function.name.startswith("_"):
                continue
            named = [argument.arg for argument in function.args.args]
            places = [
                node.value.id
                for node in ast.walk(function)
                if isinstance(node, ast.Subscript)
                and isinstance(node.ctx, ast.Store)
                and isinstance(node.value, ast.Name)
            ]
            written = [name for name in named if name in places]
            assert written == named[len(named) - len(written) :], f"{path}: {function.name}"
            writing += bool(written)
    assert writing > 20


def test_every_public_name_is_there_and_documented() -> None:
    for name in nimprep.__all__:
        assert getattr(nimprep, name) is not None
        assert name in dir(nimprep)
        if name != "__version__":
            assert getattr(nimprep, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        nimprep.nothing  # noqa: B018
    assert importlib.import_module("nimprep.conversion.run").convert is nimprep.convert


@pytest.mark.parametrize("row", LAYERS, ids="-".join)
def test_no_two_modules_of_a_floor_have_one_name(row: list[str]) -> None:
    there = [path for path in MODULES if part(path) in row and path.stem != "__init__"]
    twice = {path.stem for path in there if [p.stem for p in there].count(path.stem) > 1}
    assert not twice
