"""Row of the history: the part of a record that is stored independently of its folder."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.kinds.prints.record import RELATIVE, PrintRecord
from anisoscope.record.schema import RECORD_NAME, ContrastRecord, Record, sha256_of

CONTRAST_NAMES = {"log_ratio": "ln", "difference": "difference", "michelson": "Michelson"}
RECIPE_DIGITS = 12
MAX_TEXT = 200
MAX_REASONS = 240


@dataclass(frozen=True, kw_only=True)
class NewRow:
    """An inspection that is to enter the history.

    Attributes:
        created_at: when the record was made, UTC.
        serial: serial number of the part.
        product: product of the recipe.
        recipe: short identity of the recipe: the product, a blank, and 12 digits of the file's SHA-256.
        lot, cavity, station, operator: as far as they were said.
        verdict: PASS, FAIL, INCONCLUSIVE or INVALID.
        reasons: why; those beyond 240 characters stand in the record only.
        folder: folder of the inspection, absolute.
        seal: the record's seal, hexadecimal: no two inspections share it.
        software: program and version.
        numbers: what was measured, by label: see :func:`numbers_of`.
    """

    created_at: datetime
    serial: str
    product: str
    recipe: str
    lot: str | None = None
    cavity: str | None = None
    station: str | None = None
    operator: str | None = None
    verdict: str
    reasons: tuple[str, ...]
    folder: str
    seal: str
    software: str
    numbers: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Row(NewRow):
    """An inspection in the history; ``id`` counts from 1 without a gap, ``hash`` chains it to the row before."""

    id: int
    hash: str = ""

    def __repr__(self) -> str:
        """One line: id, moment, serial number, product, verdict."""
        return (
            f"Row({self.id}, {self.created_at:%Y-%m-%d %H:%M}, {self.serial}, {self.product}, {self.verdict})"
        )


def row_of(record: Record, folder: Path) -> NewRow:
    """Row of a finished inspection.

    Args:
        record: its record.
        folder: its folder, in which the record lies.

    Raises:
        RecordError: the record cannot be read there.
    """
    who = record.particulars
    product = storable(record.product)
    return NewRow(
        created_at=_utc(record.created_at),
        serial=storable(record.serial),
        product=product,
        recipe=f"{product} {_recipe_digits(record)}",
        lot=_text_or_none(who.lot),
        cavity=_text_or_none(who.cavity),
        station=_text_or_none(who.station),
        operator=_text_or_none(who.operator),
        verdict=record.verdict,
        reasons=_shortened(record.reasons),
        folder=str(folder.resolve()),
        seal=seal_of(folder),
        software=record.software,
        numbers=numbers_of(record),
    )


def numbers_of(record: Record) -> dict[str, float]:
    """The numbers of a record by stable labels.

    A contrast is called by kind, stage angles and tilt: ``ln 0-90``, ``ln 0-90 @10``, ``difference 90-180``. For each
    of them there are ``u …`` (standard uncertainty, prediction included), ``deviation …`` (measured - predicted),
    and ``tolerance …`` where the recipe gives one. A quantity of a print is called ``print alpha x`` and so on, with
    the same ones beside it. Then, where they exist: ``d2``, ``p``, ``area share``, ``conformance probability``,
    ``drift``.
    """
    found: dict[str, float] = {}
    for contrast in record.contrasts:
        found |= _contrast_numbers(contrast)
    if record.print is not None:
        found |= _print_numbers(record.print)
    rest = {
        "d2": record.d2,
        "p": record.p_value,
        "area share": None if record.area is None else record.area.share,
        "conformance probability": record.conformance_probability,
        "drift": record.drift,
    }
    return found | {label: value for label, value in rest.items() if value is not None}


def contrast_label(kind: str, from_deg: float, to_deg: float, tilt_deg: float) -> str:
    """The label of a contrast, such as ``ln 0-90 @10``; without tilt the last part is left out."""
    tilt = "" if tilt_deg == 0.0 else f" @{tilt_deg:g}"
    return f"{CONTRAST_NAMES.get(kind, kind)} {from_deg:g}-{to_deg:g}{tilt}"


def seal_of(folder: Path) -> str:
    """The seal of the record in a folder; of a record that bears none, the SHA-256 of the file.

    Raises:
        RecordError: there is no record that can be read.
    """
    path = folder / RECORD_NAME
    try:
        seal = json.loads(path.read_bytes()).get("seal")
        return str(seal) if seal else sha256_of(path)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}: was this inspection finished?") from error
    except (ValueError, AttributeError) as error:
        raise RecordError(f"{path} is damaged: it is no record") from error


def _contrast_numbers(contrast: ContrastRecord) -> dict[str, float]:
    label = contrast_label(contrast.kind, contrast.from_deg, contrast.to_deg, contrast.tilt_deg)
    found = {
        label: contrast.measured,
        f"u {label}": contrast.u,
        f"deviation {label}": contrast.measured - contrast.predicted,
    }
    return found if contrast.tolerance is None else found | {f"tolerance {label}": contrast.tolerance}


def _print_numbers(found: PrintRecord) -> dict[str, float]:
    numbers: dict[str, float] = {}
    for one in found.quantities:
        # what is told relative to its nominal value has everything in units of the value here
        label, unit = f"print {one.name}", one.nominal if one.name in RELATIVE else 1.0
        numbers |= {label: one.value, f"u {label}": unit * one.u, f"deviation {label}": unit * one.deviation}
        numbers[f"tolerance {label}"] = unit * one.limit
    if found.map is not None:
        numbers["area share"] = found.map.share
    return numbers


def _recipe_digits(record: Record) -> str:
    """Of the recipe's file, the first input; its content where a record names no files."""
    if record.inputs:
        return record.inputs[0].sha256[:RECIPE_DIGITS]
    text = json.dumps(record.recipe, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:RECIPE_DIGITS]


def _utc(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise RecordError(f"the record's time {text[:40]!r} is none") from None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


def _text_or_none(text: str | None) -> str | None:
    return None if text is None else storable(text)


def storable(text: str, most: int = MAX_TEXT) -> str:
    """Text that every database takes: no NUL, no half characters, and not longer than ``most``."""
    whole = text.replace("\0", "\ufffd").encode("utf-8", "replace").decode()
    return whole if len(whole) <= most else whole[: most - 1] + "…"


def _shortened(reasons: tuple[str, ...]) -> tuple[str, ...]:
    shortened: list[str] = []
    room = MAX_REASONS
    for reason in map(storable, reasons):
        if len(reason) > room:
            shortened.append(f"… {len(reasons) - len(shortened)} more in the record")
            break
        shortened.append(reason)
        room -= len(reason)
    return tuple(shortened)
