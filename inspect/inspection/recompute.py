"""The numbers of a record once more, from the raw frames and the copies of the inputs in its folder."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from anisoscope.base.errors import AnisoscopeError, RecordError
from anisoscope.base.json_fields import in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.inspection.folder import JOB
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.manifest import reopen
from anisoscope.inspection.pipeline import judge
from anisoscope.recipe.surface import NO_CELL_DEVIATION
from anisoscope.record.schema import Record, read_record

TOLERANCE = 1e-8
LEAST = 1e-9
"""Largest relative and absolute difference of equal numbers: a library picks its kernels by the processor."""
SEARCHED = {"d2": 2e-3, "p_value": 0.02}
FITTED, OF_FITS = re.compile(r"shape\.estimates\[\d+\]\.(value|u)$"), 1e-3
"""Largest relative difference of numbers that a search finds: it ends where a step gains less than 1e-4, and roundoff,
which differs between processors, decides after which step. Fits end where a step is a small part of u."""
NOT_COMPARED = frozenset({"software", "created_at", "files", "recipe", "rig", "conclusion"})
"""Origin of a record and paths of its files, whose hashes are checked instead; and words that follow from the rest."""


@dataclass(frozen=True)
class Recomputed:
    """A record computed again from its folder.

    Attributes:
        folder: the inspection folder.
        recorded: the record that lies there.
        verdict: the verdict now.
        differences: one line for every value that is not what it was.
        notes: what explains differences.
    """

    folder: Path
    recorded: Record = field(metadata=json_field(by=lambda record: record.verdict))
    verdict: str = field(metadata=json_field("recomputed"))
    differences: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    @in_json()
    def same(self) -> bool:
        """Verdict and numbers are as recorded."""
        return not self.differences


def recompute(folder: Path | str, on_progress: Advance = silent) -> Recomputed:
    """Judge the frames of a finished inspection again and compare; nothing is written.

    The prediction is computed anew. Signatures of causes, which only rank them, may come from the cache: its key holds
    all that they are computed from, the source included.

    Args:
        folder: the inspection folder.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        RecordError: the inspection is not finished, a file is missing or was changed, or an early version kept no
            copies of the inputs.
    """
    folder = Path(folder).resolve()
    recorded = read_record(folder)
    if not (folder / JOB).exists() and JOB not in {file.name for file in recorded.files}:
        raise RecordError(
            f"{folder}: recorded by {recorded.software}, which kept no copies of recipe, rig file and white reference: "
            "the record can be read, but not computed again"
        )
    manifest, job = reopen(folder)
    job = replace(job, recipe=job.kind.as_recorded(job.recipe, recorded.recipe))
    on_progress("prediction", 0, 1)
    # the prediction is made anew: a cached one would not prove that the numbers follow from the folder
    expected = job.kind.predict(job.recipe, job.rig, cached=False)
    on_progress("measurement", 0, 1)
    record, *_ = judge(manifest, job, expected, read_frames(folder, manifest), on_progress)
    # fields that an earlier version lacked cannot be compared
    old = recorded.model_dump(mode="json", exclude=set(NOT_COMPARED), exclude_unset=True)
    job.kind.rename_in(old)
    unrecorded: set[str] = set()
    now = record.model_dump(mode="json", exclude=set(NOT_COMPARED))
    new = _recorded_fields(old, now, unrecorded)
    if _causes(now) != _causes(old):
        unrecorded.add("diagnosis, which ranks another set of hypotheses now")
        new["diagnosis"] = old["diagnosis"]
    elif (old.get("diagnosis") or {}).get("tells", "") is None and now["diagnosis"]["tells"] is not None:
        unrecorded.add("diagnosis.tells, which was not computed then")
        new["diagnosis"]["tells"] = None
    then, today = old.get("optics") or {}, new.get("optics") or {}
    if then.get("model") == "wave" and (then["stated_error_per_sr"] or 0.0) < (
        today["stated_error_per_sr"] or 0.0
    ):
        unrecorded.add("optics.stated_error_per_sr, which left out what steps do beyond scalar waves")
        today["stated_error_per_sr"] = then["stated_error_per_sr"]
    before, after = (document["details"].get("area") or {} for document in (old, new))
    if before.get("u", 0.0) > after.get("u", 0.0):
        unrecorded.add("details.area.u, for which all cells near the limit were moved together")
        after["u"] = before["u"]
    if before and "cell_deviation" in (recorded.recipe.get("area") or {}):
        unrecorded.add("what follows of the marks, whose cells were judged by one ln ratio a pair of poses")
        new["details"] |= {name: old["details"][name] for name in ("area", "regions")}
        new |= {name: old[name] for name in ("reasons", "diagnosis", "conclusion") if name in old}
        new["notes"] = [note for note in new["notes"] if note != NO_CELL_DEVIATION]
    # gates did not say then what they could not see
    if "part_turn_deg" not in recorded.recipe.get("limits", {}):
        new["notes"] = [note for note in new["notes"] if not note.startswith("not watched: ")]
    notes: tuple[str, ...] = ()
    if recorded.software != record.software:
        notes = (f"recorded by {recorded.software}, recomputed by {record.software}",)
    if unrecorded:
        notes += (
            f"not compared, because the version that recorded did not tell it: {', '.join(sorted(unrecorded))}",
        )
    return Recomputed(folder, recorded, record.verdict, tuple(differences(old, new)), notes)


def recompute_or_reason(folder: Path) -> Recomputed | str:
    """The same without exceptions, for many folders: where a folder cannot be judged again, the reason."""
    try:
        return recompute(folder)
    except AnisoscopeError as error:
        return " ".join(str(error).split())


def _causes(document: dict[str, Any]) -> set[str]:
    """Names of the hypotheses of a diagnosis, of which other versions rank others; pairs follow from the numbers."""
    found = (document.get("diagnosis") or {}).get("causes") or ()
    return {cause["cause"] for cause in found if "+" not in cause["cause"]}


def _recorded_fields(old: Any, new: Any, unrecorded: set[str], name: str = "") -> Any:  # noqa: ANN401
    """The new document without keys that the old one does not have; their names are added to ``unrecorded``."""
    if isinstance(old, dict) and isinstance(new, dict):
        inner = f"{name}." if name else ""
        unrecorded |= {f"{inner}{key}" for key in new.keys() - old.keys()}
        return {
            key: _recorded_fields(old[key], value, unrecorded, f"{inner}{key}")
            for key, value in new.items()
            if key in old
        }
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return [
            _recorded_fields(before, after, unrecorded, f"{name}[]")
            for before, after in zip(old, new, strict=True)
        ]
    return new


def differences(old: Any, new: Any, name: str = "") -> Iterator[str]:  # noqa: ANN401 - what JSON can hold
    """One line for every value of two JSON documents that differs; numbers within `TOLERANCE` are the same.

    Those of a search are the same within `SEARCHED`.
    """
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            yield from differences(old.get(key), new.get(key), f"{name}.{key}".removeprefix("."))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from differences(before, after, f"{name}[{number}]")
    elif not _same(
        old, new, OF_FITS if FITTED.search(name) else SEARCHED.get(name.rpartition(".")[2], TOLERANCE)
    ):
        yield f"{name}: recorded {old!r}, recomputed {new!r}"


def _same(old: object, new: object, tolerance: float) -> bool:
    numbers = isinstance(old, int | float) and isinstance(new, int | float)
    if numbers and not (isinstance(old, bool) or isinstance(new, bool)):
        return math.isclose(float(old), float(new), rel_tol=tolerance, abs_tol=LEAST)  # type: ignore[arg-type]
    return old == new
