"""Row of the history: the part of a record that is stored independently of its folder."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.json_file import parsed_json
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.record.schema import RECORD_NAME, Record, sha256_of

RECIPE_DIGITS = 12
MAX_TEXT = 200
PRECISION = 1e-6
"""Relative precision of the stored numbers of a row."""
CAUSE = "cause "
"""Begins the label of the best cause of a diagnosis."""
MAX_REASONS = 240


def utc_text(moment: datetime) -> str:
    """A moment in UTC as ISO 8601, to the microsecond."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds")


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
        pixels: hash of the pixels of each pose's first frame, hexadecimal; not read back from the history.
    """

    created_at: datetime = field(metadata=json_field(by=utc_text))
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
    pixels: tuple[str, ...] = field(default=(), compare=False, metadata=LEFT_OUT)


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


def row_of(record: Record, folder: Path | None) -> NewRow:
    """Row of a finished inspection.

    Args:
        record: its record.
        folder: its folder, in which the record lies; None leaves folder and seal empty.

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
        folder="" if folder is None else str(folder.resolve()),
        seal="" if folder is None else seal_of(folder),
        software=record.software,
        numbers=numbers_of(record),
        pixels=_first_pixels(record),
    )


def _first_pixels(record: Record) -> tuple[str, ...]:
    """Hash of the first frame of each pose, where the record has them."""
    first = {
        (one.tilt_deg, one.commanded_deg): one.pixels
        for one in reversed(record.frames)
        if one.kind == "sample" and one.pixels
    }
    return tuple(first.values())


def numbers_of(record: Record) -> dict[str, float]:
    """The numbers of a record by stable labels.

    Those of its kind of part come first, such as ``ln 0-90 @10`` of a contrast or ``print alpha x`` of a quantity, each
    with ``u …`` (standard uncertainty, prediction included), ``deviation …`` (measured - predicted), and
    ``tolerance …`` where the recipe gives one. Then, where they exist: ``d2``, ``p``, ``area share``,
    ``conformance probability``, ``drift``; and ``cause …`` with the weight of the best cause of a diagnosis, 0 to 1,
    of a part that did not pass. Of frames that were judged anew, what was measured is not there twice: only ``d2``,
    ``p`` and the cause.
    """
    details = None if record.judged_anew else record.details
    found = {} if details is None else details.numbers()
    rest = {
        "d2": record.d2,
        "p": record.p_value,
        "area share": None if details is None else details.area_share,
        "conformance probability": record.conformance_probability,
        "drift": None if record.judged_anew else record.drift,
    }
    causes = () if record.diagnosis is None or record.verdict == "PASS" else record.diagnosis.causes[:1]
    rest |= {f"{CAUSE}{storable(one.cause)}": one.weight for one in causes if one.cause != "nothing"}
    return found | {label: value for label, value in rest.items() if value is not None}


def seal_of(folder: Path) -> str:
    """The seal of the record in a folder; of a record that bears none, the SHA-256 of the file.

    Raises:
        RecordError: there is no record that can be read.
    """
    path = folder / RECORD_NAME
    try:
        seal = parsed_json(bounded_bytes(path)).get("seal")
        return str(seal) if seal else sha256_of(path)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}: was this inspection finished?") from error
    except (ValueError, AttributeError) as error:
        raise RecordError(f"{path} is damaged: it is no record") from error


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
