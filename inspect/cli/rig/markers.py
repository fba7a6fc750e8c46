"""``anisoscope rig markers``: the markers of a fixture as a page to print."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import RigFileError, UsageError
from anisoscope.base.language import message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, Overwrite, check_new
from anisoscope.cli.rig.options import write_line

if TYPE_CHECKING:
    from anisoscope.rig.fixture import Fixture


def markers(
    *,
    pdf: Annotated[Path, Parameter(help="Page to write (.pdf), A4 at true scale.")],
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    field_mm: float | None = None,
    dpi: Annotated[float, Parameter(help="Dots of the printer per inch.")] = 1200.0,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Write a page with the markers around the part, to print at true scale; nothing moves.

    Without --rig it also prints the table [fixture] for the rig file. It warns if a module of a marker is smaller
    than three dots of the printer.

    Args:
        rig: Rig file whose table [fixture] is printed.
        field_mm: Without a rig file: shorter side of the camera's field, in mm, for four markers.

    Examples:
        anisoscope rig markers --field-mm 4.1 --pdf markers.pdf
        anisoscope rig markers --rig demo-output/bench/good/rig.toml --pdf markers.pdf --overwrite
    """
    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.commissioning.markers import FEWEST_DOTS, dots_per_module, marker_sheet, pdf_of

    if pdf.suffix.lower() != ".pdf":
        raise UsageError(f"--pdf {pdf}: the page is a PDF file; name it .pdf")
    check_new((pdf,), overwrite=overwrite)
    fixture, title = _fixture(rig, field_mm, dpi)
    page = marker_sheet(fixture, title=title)
    dots = dots_per_module(fixture, dpi)
    write_bytes(pdf, pdf_of(page))
    _print(pdf, fixture, dots, table=rig is None, json_=json_)
    if dots < FEWEST_DOTS:
        write_line(
            message(
                "a module is {dots} dots of {dpi} dpi wide, fewer than {least}: its edges will be rough; use a printer "
                "with more dots per inch, or have the page plotted on film",
                dots=f"{dots:.1f}",
                dpi=f"{dpi:g}",
                least=FEWEST_DOTS,
            )
        )
    return 0


def _fixture(rig: Path | None, field_mm: float | None, dpi: float) -> "tuple[Fixture, str]":
    from anisoscope.commissioning.markers import fixture_for_field
    from anisoscope.rig.rigfile import read_rig

    if (rig is None) == (field_mm is None):
        raise UsageError(
            "name the markers: --rig FILE with a table [fixture], or --field-mm and a new table is laid out"
        )
    if rig is None:
        assert field_mm is not None
        return fixture_for_field(field_mm, dpi), f"anisoscope: markers for a field of {field_mm:g} mm"
    file = read_rig(rig)
    if file.fixture is None:
        raise RigFileError(f"{rig}: it has no table [fixture]; --field-mm lays one out")
    return file.fixture, f"anisoscope: markers of {file.name}"


def _print(pdf: Path, fixture: "Fixture", dots: float, *, table: bool, json_: bool) -> None:
    from anisoscope.commissioning.markers import fixture_table

    if json_:
        found: dict[str, Any] = {"file": str(pdf), "fixture": fixture.model_dump(), "dots_per_module": dots}
        print_json(found)
        return
    line = message(
        "{path}: {count} markers, side {side} mm, {dots} dots a module",
        path=pdf,
        count=len(fixture.markers),
        side=f"{fixture.marker_mm:g}",
        dots=f"{dots:.1f}",
    )
    print(line)  # noqa: T201
    if table:
        print("\n" + fixture_table(fixture), end="")  # noqa: T201
