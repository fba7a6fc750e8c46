"""Between rows as the program sees them and columns of the database."""

import json
import os
import struct
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any

from anisoscope.history.chain import pack, unpack
from anisoscope.history.dispositions import Disposition
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import NewRow, Row

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)


def to_us(moment: datetime) -> int:
    """Microseconds since 1970, exactly."""
    return (moment - _EPOCH) // _MICROSECOND


def us_to_datetime(microseconds: int) -> datetime:
    """The moment that `to_us` took, in UTC."""
    return _EPOCH + timedelta(microseconds=microseconds)


def labels_of(new: NewRow) -> str:
    """The labels of its numbers, as they are stored."""
    return json.dumps(list(new.numbers), ensure_ascii=False, separators=(",", ":"))


def columns_of(new: NewRow, history: Path | None) -> dict[str, Any]:
    """The columns of an inspection, without id, labels and hashes.

    Args:
        new: the inspection.
        history: file of the history: folders beside or below it are stored relative to it, so that all of it can move.
    """
    return {
        "created_us": to_us(new.created_at),
        "serial": new.serial,
        "product": new.product,
        "recipe": new.recipe.rpartition(" ")[2],
        "lot": new.lot,
        "cavity": new.cavity,
        "station": new.station,
        "operator": new.operator,
        "verdict": new.verdict,
        "reasons": json.dumps(list(new.reasons), ensure_ascii=False, separators=(",", ":")),
        "folder": _stored_folder(new.folder, history),
        "seal": bytes.fromhex(new.seal),
        "software": new.software,
        "numbers": pack([float(value) for value in new.numbers.values()]),
    }


def row_from(values: Mapping[str, Any], history: Path | None) -> Row:
    """The inspection that a row of the database holds.

    Raises:
        HistoryError: it is damaged.
    """
    try:
        return _row(values, history)
    except (ValueError, TypeError, OverflowError, struct.error) as error:
        raise HistoryError(
            f"inspection {values['id']} of the history is damaged ({' '.join(str(error).split())[:80]}): its record is "
            f"in {str(values['folder'])[:200]}; `anisoscope history verify` says what else is damaged"
        ) from error


def _row(values: Mapping[str, Any], history: Path | None) -> Row:
    product, labels = values["product"], parsed_labels(values["labels"])
    return Row(
        id=values["id"],
        created_at=us_to_datetime(values["created_us"]),
        serial=values["serial"],
        product=product,
        recipe=f"{product} {values['recipe']}",
        lot=values["lot"],
        cavity=values["cavity"],
        station=values["station"],
        operator=values["operator"],
        verdict=values["verdict"],
        reasons=tuple(json.loads(values["reasons"])),
        folder=_relative_folder(values["folder"], history),
        seal=bytes(values["seal"]).hex(),
        software=values["software"],
        numbers=dict(zip(labels, unpack(bytes(values["numbers"]), len(labels)), strict=True)),
        hash=bytes(values["hash"]).hex(),
    )


def disposition_from(values: Mapping[str, Any]) -> Disposition:
    """The decision that a row of the database holds."""
    return Disposition(
        id=values["id"],
        inspection=values["inspection"],
        created_at=us_to_datetime(values["created_us"]),
        reviewer=values["reviewer"],
        decision=values["decision"],
        comment=values["comment"],
        hash=bytes(values["hash"]).hex(),
    )


@lru_cache(maxsize=256)
def parsed_labels(labels: str) -> tuple[str, ...]:
    """The labels that a layout holds."""
    return tuple(json.loads(labels))


def _stored_folder(folder: str, history: Path | None) -> str:
    if history is None:
        return folder
    base = _base(history)
    return folder.removeprefix(base).replace(os.sep, "/") if folder.startswith(base) else folder


@lru_cache(maxsize=16)
def _base(history: Path) -> str:
    return os.path.join(history.parent.resolve(), "")  # noqa: PTH118 - with a separator at its end


def _relative_folder(folder: str, history: Path | None) -> str:
    return folder if history is None else os.path.join(_parent(history), folder)  # noqa: PTH118 - many rows


@lru_cache(maxsize=16)
def _parent(history: Path) -> str:
    return str(history.parent)
