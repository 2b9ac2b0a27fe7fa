"""Text that others wrote, for a person's eyes: it is shown, and does nothing."""

from __future__ import annotations


def printable(text: str, *, lines: bool = False) -> str:
    """Return a text with what cannot be seen written out, such as ``\\x1b``.

    Names may come from anywhere, and a terminal obeys what some letters say: colours, titles,
    where the line begins, which way letters run.

    Parameters
    ----------
    text : str
    lines : bool
        Let line feeds be: it is a text of several lines, each made of names that were seen to.
    """
    return "".join(
        letter
        if letter.isprintable() or (lines and letter == "\n")
        else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )
