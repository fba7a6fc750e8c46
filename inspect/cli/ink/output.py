"""Output of ``anisoscope ink``."""

from typing import TYPE_CHECKING

from anisoscope.cli.tables import console, print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.ink.appearance import Show
    from anisoscope.ink.fitting import InkFit


def print_fit(found: "InkFit", title: str) -> None:
    """The table of a fit, and its warnings."""
    from anisoscope.ink.text import FIT_COLUMNS, fit_rows, summary

    print_table(title, list(FIT_COLUMNS), fit_rows(found), caption=summary(found))
    print_lines(f"Scale: {found.scale}; noise floor {found.grid.floor:.2g}/sr.")
    for warning in found.warnings:
        print_lines(f"warning: {warning}")


def print_show(shown: "Show") -> None:
    """One table of colours for every ink, each with its swatch."""
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    from anisoscope.ink.text import SHOW_COLUMNS, show_notes, show_rows

    for number, one in enumerate(shown.inks):
        rough = f"{one.ink.alpha:g}" if one.ink.isotropic else f"{one.ink.alpha:g} × {one.ink.across:g}"
        table = Table(title=escape(f"{one.ink.name}, alpha {rough}"), title_justify="left")
        for column in SHOW_COLUMNS:
            table.add_column(escape(column), justify="right")
        table.add_column("")
        for row, code in zip(show_rows(shown, number), one.hexes, strict=True):
            table.add_row(*(escape(cell) for cell in row), Text("      ", style=f"on {code}"))
        console().print(table)
        if one.ink.source:
            print_lines(f"Source: {one.ink.source}.")
    for note in show_notes(shown):
        print_lines(note)
