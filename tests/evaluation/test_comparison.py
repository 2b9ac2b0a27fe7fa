"""Several methods in one table: best, ties, names, and each notation's own escapes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError
from nimprep.evaluation import Comparison, Evaluation, Method, compare_predictions
from nimprep.evaluation.comparison import method_names, shown
from nimprep.evaluation.markup import comparison_latex, comparison_markdown
from nimprep.evaluation.text import comparison_text, evaluation_text
from nimprep.frame import LabelClass
from nimprep.schema import schema_problems
from nimprep.store.reader import Store
from tests.fakes import write_gmrp, write_png

BACKGROUND = LabelClass(0, "background", (0, 0, 0))
ROAD = LabelClass(1, "road", (0, 200, 0))
ANOMALY = LabelClass(2, "anomaly", (220, 0, 0))


def method(name: str, hits: int, classes: tuple[LabelClass, ...] = (BACKGROUND, ROAD)) -> Method:
    """Return a method that found so many of 1000 pixels of road: that is its IoU and recall."""
    counts = np.zeros((len(classes), len(classes)), np.int64)
    counts[:2, :2] = [[1000, 0], [1000 - hits, hits]]
    return Method(name, Path(name), Evaluation(classes, "test", {"a": counts}))


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["evaluate", *map(str, arguments)])


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("gmrp")
    raw = write_gmrp(root / "raw", frames=6)
    return nimprep.convert(raw, root / "s.zarr", camera=(30, 30, 15, 11), modalities=["label"])


def write_folder(store: Store, folder: Path, shift: int, split: str = "train") -> Path:
    for i in store.indices(split):
        guess = np.roll(store[int(i)].label, shift, axis=0)
        write_png(folder / f"{store.ids[i]}.png", guess)
    return folder


def test_methods_are_scored_as_each_alone(store: Store, tmp_path: Path) -> None:
    folders = [write_folder(store, tmp_path / name, n) for n, name in enumerate("abc")]
    found = compare_predictions(store, folders)
    assert [m.name for m in found.methods] == ["a", "b", "c"]
    for m, folder in zip(found.methods, folders, strict=True):
        assert m.evaluation.to_dict() == compare_predictions(store, [folder]).first.to_dict()
    assert found.best(1, "iou") == [True, False, False]


def test_the_highest_is_best_and_all_that_look_equal_are() -> None:
    close = Comparison((method("a", 900), method("b", 901), method("c", 901)))
    assert close.best(1, "iou") == [False, True, True]
    # 0.90000 and 0.90004 are both shown as 0.9000.
    counts = np.array([[0, 0], [9996, 90004]])
    nearly = Method("b", Path("b"), Evaluation((BACKGROUND, ROAD), "test", {"a": counts}))
    assert Comparison((method("a", 900), nearly)).best(1, "iou") == [True, True]
    # Nobody called anything road but b: the others' precision is undefined, never best.
    assert Comparison((method("a", 0), method("b", 1))).best(1, "precision") == [False, True]
    assert Comparison((method("a", 0), method("b", 0))).best(1, "precision") == [False, False]
    assert Comparison((method("a", 900),)).best(1, "iou") == [False]


def test_a_table_has_a_block_per_class_and_their_mean_where_there_are_several() -> None:
    one = Comparison((method("a", 900), method("b", 800))).table(("iou", "recall"))
    assert one.blocks == ("road",)
    assert one.heads == ("IoU", "recall")
    assert [cell.text for cell in one.rows[0][1]] == ["90.00", "90.00"]
    classes = (BACKGROUND, ROAD, ANOMALY)
    two = Comparison((method("a", 900, classes), method("b", 800, classes))).table()
    assert two.blocks == ("road", "anomaly", "mean")
    texts = [cell.text for cell in two.rows[0][1]]
    assert texts[:4] == ["94.74", "90.00", "100.00", "90.00"]
    # Nobody has an anomaly: undefined, and left out of the mean.
    assert texts[4:8] == [""] * 4
    assert texts[8:] == texts[:4]


def test_nobody_is_best_at_nothing() -> None:
    nothing = Comparison((method("a", 0), method("b", 0)))
    assert nothing.best(1, "iou") == [False, False]
    for text in (comparison_markdown(nothing.table()), comparison_latex(nothing.table())):
        assert "0.00" in text
        assert "**" not in text
        assert "textbf" not in text
    assert "\x1b" not in comparison_text(nothing)
    # What both would show as 0 is no best either.
    counts = np.array([[0, 0], [999_999, 1]])
    hardly = Method("b", Path("b"), Evaluation((BACKGROUND, ROAD), "test", {"a": counts}))
    assert Comparison((method("a", 0), hardly)).best(1, "iou") == [False, False]


@pytest.mark.parametrize(
    ("value", "percent", "fraction"),
    [
        (1.0, "100.00", "1.0000"),
        (2 / 3, "66.67", "0.6667"),
        (0.0, "0.00", "0.0000"),
        (0.00005, "0.01", "0.0001"),
        (float("nan"), "–", "–"),
    ],
)
def test_both_units_show_the_same_digits(value: float, percent: str, fraction: str) -> None:
    assert (shown(value, "percent"), shown(value, "fraction")) == (percent, fraction)


def test_tables_of_fractions_are_there_when_asked_for(store: Store, tmp_path: Path) -> None:
    for number, name in enumerate("ab"):
        write_folder(store, tmp_path / name, number)
    folders = (tmp_path / "a", tmp_path / "b")
    for form, expected in (("text", "1.0000*"), ("markdown", "**1.0000**"), ("latex", "{1.0000}")):
        asked = run(store.path, *folders, "--format", form, "--fraction").stdout
        assert expected in asked
        assert "%" not in asked.replace("% needs", "")
        percent = run(store.path, *folders, "--format", form, "--percent").stdout
        assert "100.00" in percent
        assert percent == run(store.path, *folders, "--format", form).stdout
    for said in ("--percent", "--fraction"):
        document = json.loads(run(store.path, *folders, "--json", said).stdout)
        assert document["unit"] == document["methods"][0]["evaluation"]["unit"] == "fraction"
        assert document["methods"][0]["evaluation"]["mean"]["iou"] == 1


def test_documents_without_a_unit_fit_the_schema_still(store: Store, tmp_path: Path) -> None:
    document = json.loads(run(store.path, write_folder(store, tmp_path / "a", 1), "--json").stdout)
    del document["unit"]
    assert schema_problems(document, "evaluation") == []
    assert schema_problems({**document, "unit": "percent"}, "evaluation")


def test_text_marks_the_best_in_bold_and_by_a_star_and_lines_up() -> None:
    text = comparison_text(Comparison((method("a", 900), method("longer", 800))), ("iou",))
    assert "\x1b[1m90.00*\x1b[0m" in text
    lines = re.sub(r"\x1b\[\d+m", "", text).splitlines()
    assert lines[0] == "1 frames of split test, 2000 pixels counted"
    assert lines[2].split() == ["in", "%", "road"]
    assert lines[3:6] == ["method      IoU", "a         90.00*", "longer    80.00"]
    assert lines[-1] == "* best, by 2 decimals"


def test_no_name_can_write_to_the_terminal() -> None:
    evil = LabelClass(1, "road\x1b]0;owned\x07\nroad", (0, 0, 0))
    found = Comparison((method("a\x1b[2J", 900, (BACKGROUND, evil)), method("b", 1)))
    plain = comparison_text(found).replace("\x1b[1m", "").replace("\x1b[0m", "")
    # Two classes of one name are two rows.
    assert (
        evaluation_text(method("a", 900, (BACKGROUND, ROAD, ROAD)).evaluation).count("\nroad") == 4
    )
    for text in (plain, evaluation_text(found.first)):
        assert "\x1b" not in text
        assert "\x07" not in text
    assert "\x1b" not in comparison_markdown(found.table())
    assert "\x1b" not in comparison_latex(found.table())


def test_markdown_is_a_table_whatever_the_names_are() -> None:
    names = ("a|b", "*c* _d_ `e` [f](g) <h> ~i~ $j$ \\ &amp;", "two\nlines")
    found = Comparison(tuple(method(name, 900 - n) for n, name in enumerate(names)))
    lines = comparison_markdown(found.table(("iou", "recall"))).splitlines()
    assert lines[0] == "| method, in % | road: IoU | road: recall |"
    assert lines[1] == "| --- | ---: | ---: |"
    assert lines[2] == r"| a\|b | **90.00** | **90.00** |"
    escaped = r"\*c\* \_d\_ \`e\` \[f\](g) \<h\> \~i\~ \$j\$ \\ \&amp;"
    assert lines[3] == f"| {escaped} | 89.90 | 89.90 |"
    assert len(lines) == 5


def test_latex_is_a_tabular_whatever_the_names_are() -> None:
    names = ("50% & more_#$", r"\{}~^<>|", "[12] a*b", "*", "x---y", "z-w", 'q"`')
    found = Comparison(tuple(method(name, 900 - n) for n, name in enumerate(names)))
    lines = comparison_latex(found.table(("iou", "recall"))).splitlines()
    assert lines[1] == r"\begin{tabular}{lrr}"
    assert lines[3] == r"in \% & \multicolumn{2}{c}{road} \\"
    assert lines[4] == r"\cmidrule(lr){2-3}"
    assert lines[7] == r"50\% \& more\_\#\$ & \textbf{90.00} & \textbf{90.00} \\"
    second = r"\textbackslash{}\{\}\textasciitilde{}\textasciicircum{}\textless{}\textgreater{}"
    assert lines[8] == rf"{second}\textbar{{}} & 89.90 & 89.90 \\"
    # After the \\ of the row above, a bare [ or * would be taken for its options.
    assert lines[9].startswith("{[}12{]} a{*}b &")
    assert lines[10].startswith("{*} &")
    assert lines[11].startswith("x-{}-{}-y &")
    assert lines[12].startswith("z-w &")
    assert lines[13].startswith("q{''}{`} &")
    assert lines[-1] == r"\end{tabular}"


@pytest.mark.parametrize(
    ("folders", "names"),
    [
        (["runs/a/pred"], ["pred"]),
        (["a/pred", "b/pred"], ["a", "b"]),
        (["runs/a/predictions/test", "runs/b/predictions/test"], ["a", "b"]),
        (["x/pred", "x/other/pred"], ["x", "other"]),
        (["a/pred", "b/pred", "c"], ["a/pred", "b/pred", "c"]),
        (["m", "n"], ["m", "n"]),
        (["a/m", "a/n", "b/n"], ["m", "a/n", "b/n"]),
        (["same", "./same"], None),
    ],
)
def test_folders_are_called_as_briefly_as_tells_them_apart(
    folders: list[str], names: list[str] | None
) -> None:
    found = method_names([Path(folder) for folder in folders])
    if names is None:
        assert found[0] == found[1]
    else:
        assert found == names


def test_the_same_folder_twice_is_refused(store: Store, tmp_path: Path) -> None:
    folder = write_folder(store, tmp_path / "a", 0)
    with pytest.raises(LayoutError, match=r"expected different folders, found .*/a, .*/a"):
        compare_predictions(store, [folder, folder])
    named = compare_predictions(store, {"x": folder, "y": folder})
    assert named.best(1, "iou") == [True, True]


def test_what_one_of_the_folders_lacks_is_named(store: Store, tmp_path: Path) -> None:
    a, b = (write_folder(store, tmp_path / name, 0) for name in "ab")
    lost = store.ids[store.indices("train")[1]]
    (b / f"{lost}.png").unlink()
    with pytest.raises(LayoutError, match=f"/b: expected a prediction .* found none for {lost}"):
        compare_predictions(store, [a, b])
    write_png(b / f"{lost}.png", np.zeros((3, 3), np.uint8))
    with pytest.raises(DecodeError, match=rf"/b/{lost}\.png: expected the frame's 32x24"):
        compare_predictions(store, [a, b])


def test_folders_of_different_splits_are_refused(store: Store, tmp_path: Path) -> None:
    a = write_folder(store, tmp_path / "a", 0)
    b = write_folder(store, tmp_path / "b", 0, "test")
    with pytest.raises(LayoutError, match=r"of split 'train' like .*/a, found .* split 'test'"):
        compare_predictions(store, [a, b])


def test_the_command_prints_every_notation(store: Store, tmp_path: Path) -> None:
    for number, name in enumerate("ab"):
        write_folder(store, tmp_path / name / "pred", number)
    folders = (tmp_path / "a" / "pred", tmp_path / "b" / "pred")
    text = run(store.path, *folders)
    assert text.exit_code == 0
    assert re.search(r"^a +100\.00\* ", text.stdout, re.MULTILINE)
    # Not a terminal: no codes.
    assert "\x1b" not in text.stdout
    assert "| a | **100.00** |" in run(store.path, *folders, "--format", "markdown").stdout
    assert r"a & \textbf{100.00} &" in run(store.path, *folders, "--format", "latex").stdout
    document = json.loads(run(store.path, *folders, "--json").stdout)
    assert document == json.loads(run(store.path, *folders, "--format", "json").stdout)
    assert schema_problems(document, "evaluation") == []
    assert [m["name"] for m in document["methods"]] == ["a", "b"]
    assert document["best"]["mean"]["iou"] == ["a"]
    assert document["best"]["classes"][0]["name"] == "drivable area"
    assert schema_problems({**document, "best": {}}, "evaluation")


def test_the_command_takes_names_and_chosen_metrics(store: Store, tmp_path: Path) -> None:
    a, b = (write_folder(store, tmp_path / name, n) for n, name in enumerate("ab"))
    result = run(
        store.path, f"NIM-RGB+D={a}", f"RGB={b}", "--format", "markdown", "--metrics", "iou"
    )
    assert result.stdout.splitlines()[2].startswith("| NIM-RGB+D | **100.00** |")
    assert result.stdout.count("IoU") == 3
    assert "F-score" not in result.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("--json", "--format", "text"),
        ("--metrics", "accuracy"),
        ("--format", "html"),
        ("--worst", "-1"),
    ],
)
def test_a_wrong_call_exits_2(store: Store, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    assert run(store.path, tmp_path, *arguments).exit_code == 2


def test_names_for_some_folders_only_or_twice_exit_2(store: Store, tmp_path: Path) -> None:
    assert run(store.path, f"x={tmp_path}", tmp_path).exit_code == 2
    assert run(store.path, f"x={tmp_path}", f"x={tmp_path}/y").exit_code == 2


def test_a_bad_folder_among_several_exits_1_in_one_line(store: Store, tmp_path: Path) -> None:
    a = write_folder(store, tmp_path / "a", 0)
    result = run(store.path, a, tmp_path / "nowhere")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr == f"error: {tmp_path}/nowhere: expected a folder of predictions, " + (
        "found none\n"
    )


def test_the_text_of_one_folder_lists_the_worst_frames(store: Store, tmp_path: Path) -> None:
    folder = write_folder(store, tmp_path / "a", 0)
    worst = store.ids[store.indices("train")[2]]
    write_png(folder / f"{worst}.png", np.zeros((24, 32), np.uint8))
    lines = run(store.path, folder, "--worst", "1").stdout.splitlines()
    place = next(n for n, line in enumerate(lines) if line.startswith("mean, worst frames first"))
    assert lines[place + 1].split() == [worst, "0.00", "0.00", "–", "0.00"]
    assert len(lines) == place + 4
    assert "worst" not in run(store.path, folder, "--worst", "0").stdout
