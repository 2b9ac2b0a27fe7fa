"""Whose a dataset is: what those who use a store of it are to respect and to cite."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Say whose a dataset is: what to respect and to cite; "" = not said.

    Attributes
    ----------
    title : str
    licence : str
    citation : str
        A reference, or BibTeX.
    paper : str
        Its DOI or address.
    url : str
        Where the dataset is had from.
    """

    title: str = ""
    licence: str = ""
    citation: str = ""
    paper: str = ""
    url: str = ""

    def to_json(self) -> dict[str, str]:
        """Return what is said."""
        return {name: value for name, value in asdict(self).items() if value}
