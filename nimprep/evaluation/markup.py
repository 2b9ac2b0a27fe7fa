"""The table of methods and measures as Markdown and as LaTeX."""

from __future__ import annotations

import re

from nimprep.evaluation.comparison import CORNER, UNDEFINED, Table
from nimprep.text import printable

_MARKDOWN = {ord(c): f"\\{c}" for c in "\\`*_[]<>|~&$"}
"""What would be taken for markup inside a table's cell; GitHub reads $ as mathematics."""

_LATEX = {
    ord(character): replacement
    for character, replacement in {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "$": r"\$",
        "&": r"\&",
        "#": r"\#",
        "_": r"\_",
        "%": r"\%",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        '"': "{''}",
        "`": "{`}",
        # After the \\ that ends a row, these would be taken for its options.
        "[": "{[}",
        "]": "{]}",
        "*": "{*}",
    }.items()
}


def comparison_markdown(table: Table) -> str:
    """Return the table as GitHub Flavored Markdown, the best scores in bold."""
    heads = [_markdown(f"{block}: {head}") for block in table.blocks for head in table.heads]
    corner = ", ".join(filter(None, ("method", CORNER[table.unit])))
    lines = [[corner, *heads], ["---", *["---:"] * len(heads)]]
    for name, cells in table.rows:
        texts = (f"**{cell.text}**" if cell.best else cell.text or UNDEFINED for cell in cells)
        lines.append([_markdown(name), *texts])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _markdown(text: str) -> str:
    return printable(text).translate(_MARKDOWN)


def comparison_latex(table: Table) -> str:
    """Return the table as LaTeX for the package booktabs, the best scores in bold."""
    number = len(table.heads)
    spans = [f"\\multicolumn{{{number}}}{{c}}{{{_latex(block)}}}" for block in table.blocks]
    rules = [
        f"\\cmidrule(lr){{{2 + i * number}-{1 + (i + 1) * number}}}"
        for i in range(len(table.blocks))
    ]
    heads = [_latex(head) for _ in table.blocks for head in table.heads]
    lines = [
        r"% needs \usepackage{booktabs}",
        f"\\begin{{tabular}}{{l{'r' * len(heads)}}}",
        r"\toprule",
        f"{_latex(CORNER[table.unit])} & {' & '.join(spans)} \\\\",
        "".join(rules),
        f"method & {' & '.join(heads)} \\\\",
        r"\midrule",
    ]
    for name, cells in table.rows:
        texts = (f"\\textbf{{{cell.text}}}" if cell.best else cell.text or "--" for cell in cells)
        lines.append(f"{_latex(name)} & {' & '.join(texts)} \\\\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _latex(text: str) -> str:
    escaped = printable(text).translate(_LATEX)
    # Two or three hyphens in a row would become one dash.
    return re.sub("-(?=-)", "-{}", escaped)
