"""The archive of finished inspections: pushed, fetched, proven, held, and deleted by rules that are written down.

Every file is stored once, by its hash, under ``objects``. An inspection is archived when its manifest is there, which
is written last; so whatever breaks a push off, the next one goes on, and nothing doubles. What is deleted leaves
a note under ``deleted`` first. Nothing local is removed before all its files were read back and hashed.

Objects that nothing refers to are cleared away under a mark, ``clearing.json``. A push looks for the mark after its
manifest is written, and for its objects after that: so it ends only when no clearing can have missed the manifest.
"""

import contextlib
import hashlib
import json
import math
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import quote

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.crash import as_foreseen
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.last_signed import HEADS, noted
from anisoscope.base.parallel import for_each
from anisoscope.base.progress import Advance, silent
from anisoscope.base.signature import Signed, Trust, read_signed, signer_in_use
from anisoscope.base.toml_file import one_line
from anisoscope.history.rows import seal_of
from anisoscope.inspection.archive_store import ArchiveError, Store, Stored
from anisoscope.inspection.folder import INPUTS, sweep, working_in
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.objects import (
    ARCHIVE,
    LARGE,
    OBJECTS,
    clear_unused,
    object_name,
    objects_of,
    share,
)
from anisoscope.inspection.report_seal import REPORT_SIGNATURE, SEAL_NAME
from anisoscope.record.schema import (
    RECORD_NAME,
    REPORT_NAME,
    SIGNATURE_NAME,
    InputFile,
    read_record,
    record_signature,
    recorded_files,
    sha256_of,
)

FORMAT = 1
INSPECTIONS, HOLDS, RELEASED, DELETED = "inspections", "holds", "released", "deleted"
STATIONS = "stations"
CLEARING = "clearing.json"
CLOCK = "clock"
CLOCK_OFF = timedelta(hours=1)
"""Clocks of this computer and of the archive differ by less, or nothing is deleted."""
REMOVED = ".removed-"
PULLED = ".pulled-"
GRACE = timedelta(days=1)
"""Objects that nothing refers to stay so long: a push may be under way that will."""
AT_ONCE = 64
"""Manifests that are read in one go."""
Model = TypeVar("Model", bound=BaseModel)


class _Stored(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ArchivedFile(InputFile):
    """A file of an inspection, with its number of bytes."""

    size: int

    @property
    def object(self) -> str:
        """Its name in the archive."""
        return f"{OBJECTS}/{object_name(self)}"


class Archived(_Stored):
    """The manifest of an archived inspection; ``name`` is that of its folder, times are UTC."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    name: str
    seal: str
    kind: str
    serial: str
    product: str
    verdict: str
    lot: str | None = None
    station: str | None = None
    created_at: datetime
    pushed_at: datetime
    files: tuple[ArchivedFile, ...]

    @property
    def key(self) -> str:
        """Its name in the archive, from which day, folder and verdict can be read."""
        return f"{INSPECTIONS}/{self.created_at:%Y-%m-%d}/{self.name}~{self.verdict}~{self.seal[:12]}.json"

    @property
    def bytes(self) -> int:
        """Bytes of all its files."""
        return sum(file.size for file in self.files)


class Hold(_Stored):
    """A legal hold: an inspection that no rule deletes."""

    name: str
    seal: str
    reason: str
    by: str
    since: datetime


class Released(_Stored):
    """A note on a legal hold that was ended: why, by whom and when; it stays."""

    hold: Hold
    reason: str
    by: str
    released_at: datetime


class Deleted(_Stored):
    """A note on what was deleted, by which rule, when and by whom; it stays."""

    inspection: Archived
    rule: str
    by: str
    deleted_at: datetime


class HeadNote(_Stored):
    """Number of a signed head, and SHA-256 of its envelope."""

    number: int
    sha256: str


class StationKeys(_Stored):
    """What a station of this name signed.

    Attributes:
        station: its name.
        keys: by which it signed what it archived, each with its first and last time.
        heads: by history, number and hash of the last head that it signed.
    """

    station: str
    keys: dict[str, tuple[datetime, datetime]]
    heads: dict[str, HeadNote] = {}


class Rule(_Stored):
    """A rule of retention: inspections that it fits stay for so many days; the first that fits counts.

    Attributes:
        days: from the inspection on; None for ever.
        verdict: PASS, FAIL, INCONCLUSIVE or INVALID; any without.
        product: of the recipe; any without.
    """

    days: Annotated[int, Field(ge=1)] | None
    verdict: Literal["PASS", "FAIL", "INCONCLUSIVE", "INVALID"] | None = None
    product: str | None = None

    def fits(self, one: Archived) -> bool:
        """Whether it is a rule for this inspection."""
        return self.verdict in {None, one.verdict} and self.product in {None, one.product}

    def __str__(self) -> str:
        """As the record of a deletion names it."""
        what = [
            f"{key} {value}" for key, value in (("verdict", self.verdict), ("product", self.product)) if value
        ]
        return f"{', '.join(what) or 'all'}: {'for ever' if self.days is None else f'{self.days} days'}"


def parse_rule(text: str) -> Rule:
    """A rule such as ``FAIL:3650``, ``PASS:365``, ``product=lid:90`` or ``all:ever``.

    Raises:
        UsageError: it is none.
    """
    what, _, days = text.rpartition(":")
    values: dict[str, Any] = {"days": None if days == "ever" else days}
    for part in filter(None, (one.strip() for one in what.split(","))):
        if part.startswith("product="):
            values["product"] = part.removeprefix("product=")
        elif part != "all":
            values["verdict"] = part.upper()
    try:
        return Rule.model_validate(values)
    except ValidationError:
        raise UsageError(
            f"--rule takes WHAT:DAYS, such as FAIL:3650, PASS:365, product=lid,PASS:90 or all:ever, not {text[:80]!r}"
        ) from None


# ---- the archive ----------------------------------------------------------------------------------------------------


def check_format(store: Store, *, begin: bool = False) -> None:
    """Check that this version can use an archive; ``begin`` one where there is none.

    Raises:
        ArchiveError: a later version began it, it is none, or there is none.
    """
    content = store.read(ARCHIVE)
    if content is None:
        if not begin:
            raise ArchiveError(
                f"{store.url}: is no archive, or an empty one: `anisoscope archive push` begins one"
            )
        store.write(ARCHIVE, json.dumps({"anisoscope_archive": FORMAT}).encode())
        return
    try:
        version = json.loads(content)["anisoscope_archive"]
    except (ValueError, TypeError, KeyError):
        raise ArchiveError(f"{store.url}: its {ARCHIVE} is damaged") from None
    if not isinstance(version, int) or version > FORMAT:
        raise ArchiveError(
            f"{store.url}: a later version of anisoscope keeps this archive ({version}): update anisoscope"
        )


def archived(store: Store) -> list[str]:
    """Names of all manifests, the oldest day first."""
    return [one.name for one in store.files(INSPECTIONS) if one.name.endswith(".json")]


def archived_verdicts(store: Store) -> dict[str, str]:
    """Verdicts of all archived inspections by the first 12 digits of their seals, from the names of their manifests.

    Raises:
        ArchiveError: there is no archive, or it does not answer.
    """
    check_format(store)
    parts = (PurePosixPath(name).stem.split("~") for name in archived(store))
    return {seal: verdict for _, verdict, seal in parts}


def read_manifest(store: Store, name: str) -> Archived:
    """A manifest.

    Raises:
        ArchiveError: it is gone or damaged, or the store does not answer.
    """
    return _read(store, name, Archived)


def _read(store: Store, name: str, model: type[Model]) -> Model:
    content = store.read(name)
    if content is None:
        raise ArchiveError(f"{store.url}/{name}: is gone")
    try:
        return model.model_validate_json(content)
    except ValidationError as error:
        raise ArchiveError(f"{store.url}/{name}: is damaged: {one_line(error, model)}") from error


def manifests(store: Store, names: Sequence[str], advance: Advance = silent) -> Iterator[Archived]:
    """Manifests, several read at a time."""
    for first in range(0, len(names), AT_ONCE):
        advance("manifests", first, len(names))
        yield from for_each(partial(read_manifest, store), names[first : first + AT_ONCE])


def fits_name(key: str, wanted: str) -> bool:
    """Whether a manifest is of a folder or a serial number."""
    folder = PurePosixPath(key).name.split("~")[0]
    return wanted in {folder, re.sub(r"-\d{8}T\d{6}Z(-\d+)?$", "", folder)}


# ---- push -----------------------------------------------------------------------------------------------------------


def finished_folders(places: Iterable[Path]) -> list[Path]:
    """Finished inspections among folders and below them.

    Raises:
        RecordError: a place is no folder.
    """
    found: set[Path] = set()
    for place in places:
        if not place.is_dir():
            raise RecordError(f"{place}: there is no such folder")
        records = place.rglob(RECORD_NAME)
        found |= {one.parent.resolve() for one in records if not _hidden(one.relative_to(place))}
    return sorted(found)


def _hidden(path: Path) -> bool:
    return any(part.startswith((REMOVED, PULLED)) for part in path.parts)


@dataclass(frozen=True)
class Pushed:
    """An inspection in the archive.

    Attributes:
        folder: of the inspection, on this computer.
        key: of its manifest.
        new: whether it was not there yet.
        sent_bytes: what was sent now; what the archive had is not sent again.
        removed: whether the local folder was removed.
    """

    folder: str
    key: str
    new: bool
    sent_bytes: int
    removed: bool = False


def push(
    store: Store,
    folder: Path,
    *,
    remove: bool = False,
    now: datetime | None = None,
    proven: set[str] | None = None,
) -> Pushed:
    """Archive a finished inspection; one that is there is not sent again.

    Args:
        store: of the archive.
        folder: the inspection folder.
        remove: remove the local folder, once every file was read back from the archive and its hash is right.
        now: the time.
        proven: objects that were read back earlier in this run, which inspections have in common; more are added.

    Raises:
        RecordError: the folder is not finished, or not as it was: that is not archived.
        ArchiveError: the archive does not answer, or does not hold what it should.
    """
    now, trash = now or datetime.now(UTC), folder.with_name(f"{REMOVED}{folder.name}")
    proven = set() if proven is None else proven
    with working_in(folder):
        one = _manifest_of(folder, now)
        new, sent = store.read(one.key) is None, set[ArchivedFile]()
        if new:
            found = verify(folder)
            if not found.intact:
                wrong = [*found.changed, *found.missing, *found.additional, *found.distrust]
                raise RecordError(f"{folder}: is not as it was ({', '.join(wrong[:3])}): it is not archived")
            sent = _send(store, folder, [file for file in one.files if file.object not in proven])
            store.write(one.key, one.model_dump_json(by_alias=True, indent=1).encode())
        elif len(one.files) <= len((there := read_manifest(store, one.key)).files):
            one = there
        else:  # the report was written since
            sent = _send(store, folder, one.files)
            store.write(one.key, one.model_dump_json(by_alias=True, indent=1).encode())
        _check_clearing(store, now)
        # what is not of today may have been cleared away meanwhile
        again = _send(store, folder, [file for file in one.files if file not in sent])
        proven.difference_update(file.object for file in again)
        if remove:
            _prove(store, one, proven)
            folder.rename(trash)
    if remove:
        shutil.rmtree(trash, ignore_errors=True)
    return Pushed(str(folder), one.key, new, sum(file.size for file in sent | again), remove)


def _check_clearing(store: Store, now: datetime) -> None:
    content = store.read(CLEARING)
    if content is None:
        return
    check_clock(store, now)
    with contextlib.suppress(ValueError):
        if abs(now - datetime.fromisoformat(content.decode())) > GRACE:
            return  # of a program that was killed
    raise ArchiveError(f"{store.url}: `archive retain` is at work there: push again when it has ended")


def _manifest_of(folder: Path, now: datetime) -> Archived:
    record = read_record(folder)
    files = [*recorded_files(folder)]
    own = (RECORD_NAME, SIGNATURE_NAME, REPORT_NAME, SEAL_NAME, REPORT_SIGNATURE)
    listed = {file.name for file in files}
    files += [
        InputFile(name=name, sha256=sha256_of(folder / name))
        for name in own
        if name not in listed and (folder / name).is_file()
    ]
    sized = []
    for file in files:
        place = folder / file.name
        if not place.is_file():
            raise RecordError(f"{place}: is gone; the inspection is not archived")
        sized.append(ArchivedFile(name=file.name, sha256=file.sha256, size=place.stat().st_size))
    return Archived(
        name=folder.name,
        seal=seal_of(folder),
        kind=record.kind,
        serial=record.serial,
        product=record.product,
        verdict=record.verdict,
        lot=record.particulars.lot,
        station=record.particulars.station,
        created_at=datetime.fromisoformat(record.created_at),
        pushed_at=now,
        files=tuple(sized),
    )


def _send(store: Store, folder: Path, files: Sequence[ArchivedFile]) -> set[ArchivedFile]:
    """Send the files that the archive does not have; those that were sent."""

    def send(file: ArchivedFile) -> bool:
        if store.size(file.object) == file.size:
            return False
        store.put(file.object, folder / file.name)
        return True

    return {file for file, was in zip(files, for_each(send, files), strict=True) if was}


def _prove(store: Store, one: Archived, proven: set[str]) -> None:
    """Read every file of an inspection back that is not proven yet.

    Raises:
        ArchiveError: one is not what it was.
    """
    files = [file for file in one.files if file.object not in proven]
    right = for_each(lambda file: _is_right(store, file.object, file.sha256), files)
    wrong = [file.name for file, good in zip(files, right, strict=True) if not good]
    if wrong:
        raise ArchiveError(
            f"{store.url}: of {one.name} the archive holds damaged files ({', '.join(wrong[:3])})"
        )
    proven.update(file.object for file in files)


def _is_right(store: Store, name: str, sha256: str) -> bool:
    content = store.read(name)
    return content is not None and hashlib.sha256(content).hexdigest() == sha256


def clear_removed(place: Path) -> None:
    """Remove what is left of folders that were archived and whose removal was broken off."""
    for trash in place.rglob(f"{REMOVED}*"):
        shutil.rmtree(trash, ignore_errors=True)


def noted_heads(store: Store, history: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Where in the archive a signed head of a history was noted, and its number and hash.

    Raises:
        ArchiveError: the archive does not answer, or a note is damaged.
    """
    for one in store.files(STATIONS):
        note = _read(store, one.name, StationKeys).heads.get(history)
        if note is not None:
            yield f"{store.url}/{one.name}", note.model_dump()


def note_keys(
    store: Store, signed: Iterable[tuple[str, Signed]], heads: Mapping[str, HeadNote] | None = None
) -> list[str]:
    """Note which keys the stations sign by; a line for each name under which two keys sign in turn.

    A key that replaced another one signs after it, and the earlier one no more.

    Args:
        store: of the archive.
        signed: stations by name, and signatures of their records.
        heads: the last head that was signed here, by history; one of a lower number than the note is not noted.

    Raises:
        ArchiveError: the archive does not answer, or a note is damaged.
    """
    stations: dict[str, list[Signed]] = {}
    for station, one in signed:
        stations.setdefault(station, []).append(one)
    lines = []
    heads = heads or {}
    for station, those in stations.items():
        name = f"{STATIONS}/{quote(station, safe='')}.json"
        known = StationKeys(station=station, keys={})
        known = known if store.size(name) is None else _read(store, name, StationKeys)
        keys = dict(known.keys)
        for one in those:
            first, last = keys.get(one.key, (one.signed_at, one.signed_at))
            keys[one.key] = min(first, one.signed_at), max(last, one.signed_at)
        latest = known.heads | {
            place: note
            for place, note in heads.items()
            if place not in known.heads or note.number > known.heads[place].number
        }
        new = StationKeys(station=station, keys=keys, heads=latest)
        if new != known:
            store.write(name, new.model_dump_json(indent=1).encode())
        spans = sorted((first, last, key) for key, (first, last) in keys.items())
        lines += [
            f"two stations are called {station!r}: the keys {before[2]} and {after[2]} sign in turn; give one of them "
            "another name"
            for before, after in pairwise(spans)
            if after[0] < before[1]
        ]
    return lines


# ---- pull -----------------------------------------------------------------------------------------------------------


def pull(store: Store, one: Archived, out: Path) -> Path:
    """Fetch an inspection into a folder that holds all its files; what an earlier try fetched is not fetched again.

    Raises:
        RecordError: another inspection has that folder, or it cannot be written.
        ArchiveError: a file is missing or damaged there.
    """
    folder, partial_folder = out / one.name, out / f"{PULLED}{one.name}"
    if folder.exists():
        if (folder / RECORD_NAME).is_file() and seal_of(folder) == one.seal:
            return folder
        raise RecordError(f"{folder}: another inspection is there; name another --out")
    try:
        partial_folder.mkdir(parents=True, exist_ok=True)
        with working_in(partial_folder):
            for file in one.files:
                _fetch(store, file, partial_folder / file.name)
                if file.name.startswith(f"{INPUTS}/") and file.size >= LARGE:
                    share(file, partial_folder)
            sweep(partial_folder)
            partial_folder.rename(folder)
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from error
    return folder


def _fetch(store: Store, file: ArchivedFile, path: Path) -> None:
    if path.is_file() and sha256_of(path) == file.sha256:
        return
    content = store.read(file.object)
    if content is None or hashlib.sha256(content).hexdigest() != file.sha256:
        what = "is gone" if content is None else "is damaged"
        raise ArchiveError(f"{store.url}/{file.object}: {what}; it is {file.name} of an inspection")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content)


# ---- verify ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Proven:
    """Result of a sample of an archive.

    Attributes:
        inspections: manifests that were read.
        objects: stored files that they refer to.
        hashed: how many of these were read and hashed.
        damaged: names of those that are not what they were.
        missing: names of those that are gone.
        unread: manifests that cannot be read, with the reason.
        share: upper limit of the damaged share of the objects, with the confidence.
        confidence: of that limit.
        distrust: inspections that no trusted key signed as they are, or that follow one which is gone.
    """

    inspections: int
    objects: int
    hashed: int
    damaged: tuple[str, ...]
    missing: tuple[str, ...]
    unread: tuple[str, ...]
    share: float
    confidence: float
    distrust: tuple[str, ...] = ()

    @property
    def intact(self) -> bool:
        """Whether nothing was found wrong."""
        return not (self.damaged or self.missing or self.unread or self.distrust)


def sample_size(objects: int, share: float, confidence: float) -> int:
    """Fewest objects to hash, none of them damaged, to say that at most a share is damaged, with a confidence.

    Drawn without replacement: the chance to miss D damaged ones of N with n is C(N − D, n)/C(N, n), with D the least
    number above the share.
    """
    if share <= 0.0:
        return objects
    damaged = math.floor(share * objects) + 1
    if damaged > objects:
        return 0
    low, high = 0, objects - damaged + 1
    while low < high:
        middle = (low + high) // 2
        if _miss(objects, damaged, middle) <= 1.0 - confidence:
            high = middle
        else:
            low = middle + 1
    return low


def _miss(objects: int, damaged: int, drawn: int) -> float:
    if drawn > objects - damaged:
        return 0.0
    terms = (math.lgamma(objects - damaged + 1), math.lgamma(objects - drawn + 1))
    others = (math.lgamma(objects - damaged - drawn + 1), math.lgamma(objects + 1))
    return math.exp(sum(terms) - sum(others))


def upper_share(objects: int, hashed: int, found: int, confidence: float) -> float:
    """Largest share of damaged objects that leaves as few as were found in a sample with 1 − confidence.

    Clopper and Pearson's limit, on the safe side for draws without replacement; 0 damaged of all objects is 0.
    """
    if hashed >= objects:
        return found / objects if objects else 0.0
    if hashed == 0:
        return 1.0
    from scipy.special import betaincinv  # noqa: PLC0415 - start-up time

    if found == 0:
        low, high = 0, objects
        while low < high:  # the most damaged ones that such a sample misses
            middle = (low + high + 1) // 2
            low, high = (
                (middle, high) if _miss(objects, middle, hashed) > 1.0 - confidence else (low, middle - 1)
            )
        return low / objects
    return float(betaincinv(found + 1, hashed - found, confidence))


def distrusted(store: Store, those: Sequence[Archived], trust: Trust) -> Iterator[str]:
    """What is wrong with the signatures of archived inspections, and with their sequence.

    Each manifest has to say what the signed record says, and each record has to follow one that is archived, or that a
    note of its deletion names.

    Args:
        store: of the archive.
        those: all manifests.
        trust: keys that count.

    Raises:
        ArchiveError: the archive does not answer.
    """
    notes = (one.name for one in store.files(DELETED) if one.name.endswith(".json"))
    seals = {one.seal for one in those} | {_read(store, name, Deleted).inspection.seal for name in notes}
    linked: set[str] = set()
    for one in sorted(those, key=lambda one: one.created_at):
        files = {file.name: file for file in one.files}
        try:
            content, envelope = (store.read(files[name].object) for name in (RECORD_NAME, SIGNATURE_NAME))
            found = read_signed("record", envelope or b"")
            record = json.loads(content or b"")
            signed_hash = found.content.get("record")
            if {signed_hash, files[RECORD_NAME].sha256} != {hashlib.sha256(content or b"").hexdigest()}:
                raise ValueError("the record is another one than was signed")
            unlike = {(file["name"], file["sha256"]) for file in record["files"]}
            unlike -= {(file.name, file.sha256) for file in one.files}
            said = {
                name: found.content.get(name) for name in ("serial", "product", "verdict", "lot", "station")
            }
            wrong = [name for name, value in said.items() if value != getattr(one, name)]
            problem = trust.distrust(found)
        except KeyError:
            yield f"{one.key}: the record is not signed"
            continue
        except (ValueError, TypeError) as error:
            yield f"{one.key}: {error}"
            continue
        if unlike or wrong or record.get("seal") != one.seal:
            what = min(unlike)[0] if unlike else wrong[0] if wrong else "seal"
            problem = f"its manifest says another {what} than the signed record"
        number, previous = found.content.get("number"), found.content.get("previous")
        if problem is None and number is None and found.key in linked:
            problem = "the record does not say which one was before it, and earlier ones do"
        elif problem is None and number not in (None, 1) and previous not in seals:
            problem = f"record {int(number) - 1} of its station is neither archived nor noted as deleted"
        if number is not None:
            linked.add(found.key)
        if problem is not None:
            yield f"{one.key}: {problem}"


def prove(
    store: Store,
    share: float,
    confidence: float,
    rng: np.random.Generator,
    advance: Advance = silent,
    trust: Trust | None = None,
) -> Proven:
    """Check that an archive holds what its manifests say, and hash a sample of it.

    Args:
        store: of the archive.
        share: of damaged objects that is to be excluded; 0 hashes all of them.
        confidence: with which.
        rng: draws the sample.
        advance: progress.
        trust: keys of which one has to have signed each record; the small files of all inspections are read then.

    Raises:
        ArchiveError: the archive does not answer.
    """
    check_format(store)
    there = {one.name: one.size for one in store.files(OBJECTS)}
    wanted: dict[str, ArchivedFile] = {}
    names, unread, read = archived(store), [], list[Archived]()
    for number, name in enumerate(names):
        advance("manifests", number, len(names))
        try:
            one = read_manifest(store, name)
            wanted |= {file.object: file for file in one.files}
            read += [] if trust is None else [one]
        except ArchiveError as error:
            unread.append(str(error))
    missing = tuple(sorted(name for name, file in wanted.items() if there.get(name) != file.size))
    present = sorted(wanted.keys() - set(missing))
    count = min(len(present), sample_size(len(wanted), share, confidence))
    chosen = [present[k] for k in sorted(rng.choice(len(present), count, replace=False))] if count else []
    damaged = []
    for first in range(0, len(chosen), AT_ONCE):
        advance("hashing", first, len(chosen))
        part = chosen[first : first + AT_ONCE]
        right = for_each(lambda name: _is_right(store, name, wanted[name].sha256), part)
        damaged += [name for name, good in zip(part, right, strict=True) if not good]
    limit = upper_share(len(wanted), len(chosen) + len(missing), len(damaged) + len(missing), confidence)
    distrust = () if trust is None else tuple(distrusted(store, read, trust))
    return Proven(
        len(names),
        len(wanted),
        len(chosen),
        tuple(damaged),
        missing,
        tuple(unread),
        limit,
        confidence,
        distrust,
    )


# ---- retention ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Due:
    """An inspection that a rule lets go, and whether a hold keeps it."""

    inspection: Archived
    rule: str
    held: str | None = None


def check_clock(store: Store, now: datetime) -> None:
    """Compare the clock of this computer with that of the archive, whose files bear its time.

    Raises:
        ArchiveError: they differ by an hour or more, or the archive does not answer.
    """
    store.write(f"{CLOCK}/now", b"")
    written_at = max((one.written_at for one in store.files(CLOCK)), default=now)
    off = now - written_at
    if abs(off) >= CLOCK_OFF:
        raise ArchiveError(
            f"{store.url}: the clock of this computer is {abs(off) / timedelta(hours=1):.0f} h "
            f"{'ahead of' if off > timedelta(0) else 'behind'} that of the archive: set the clock; nothing is deleted"
        )


def hold(store: Store, one: Archived, reason: str, by: str, now: datetime | None = None) -> None:
    """Put an inspection under legal hold: no rule deletes it.

    Raises:
        UsageError: it is already.
    """
    if store.size(_hold_name(one)) is not None:
        there = _read(store, _hold_name(one), Hold)
        raise UsageError(
            f"{one.name} is under legal hold already, by {there.by}: {there.reason}; --release it first"
        )
    note = Hold(name=one.name, seal=one.seal, reason=reason, by=by, since=now or datetime.now(UTC))
    store.write(_hold_name(one), note.model_dump_json(indent=1).encode())


def release(store: Store, one: Archived, reason: str, by: str, now: datetime | None = None) -> bool:
    """End a legal hold, after a note why; whether there was one."""
    if store.size(_hold_name(one)) is None:
        return False
    there = _read(store, _hold_name(one), Hold)
    note = Released(hold=there, reason=reason, by=by, released_at=now or datetime.now(UTC))
    name = f"{RELEASED}/{one.name}~{one.seal[:12]}~{note.released_at:%Y%m%dT%H%M%S%f}.json"
    store.write(name, note.model_dump_json(indent=1).encode())
    store.delete(_hold_name(one))
    return True


def _hold_name(one: Archived) -> str:
    return f"{HOLDS}/{one.name}~{one.seal[:12]}.json"


def due(store: Store, rules: Sequence[Rule], now: datetime, advance: Advance = silent) -> list[Due]:
    """Inspections that the rules let go; those that no rule fits stay.

    Raises:
        ArchiveError: a manifest or a hold cannot be read: nothing is deleted then.
    """
    held = {one.name for one in store.files(HOLDS)}
    found = []
    for one in manifests(store, archived(store), advance):
        rule = next((rule for rule in rules if rule.fits(one)), None)
        if rule is None or rule.days is None or now - one.created_at <= timedelta(days=rule.days):
            continue
        name = _hold_name(one)
        found.append(Due(one, str(rule), _read(store, name, Hold).reason if name in held else None))
    return found


def let_go(store: Store, one: Due, by: str, now: datetime) -> None:
    """Delete an inspection from the archive: first the note why, then its manifest; its objects go with `clear`.

    Raises:
        UsageError: it is under legal hold.
        ArchiveError: the archive does not answer.
    """
    inspection = one.inspection
    if one.held is not None or store.size(_hold_name(inspection)) is not None:
        raise UsageError(f"{inspection.name} is under legal hold")
    note = Deleted(inspection=inspection, rule=one.rule, by=by, deleted_at=now)
    name = f"{DELETED}/{inspection.name}~{inspection.seal[:12]}.json"
    store.write(name, note.model_dump_json(by_alias=True, indent=1).encode())
    store.delete(inspection.key)


def clear(store: Store, now: datetime, advance: Advance = silent) -> tuple[int, int]:
    """Delete the objects that no inspection refers to and that are older than a day; how many, and their bytes.

    Raises:
        ArchiveError: a manifest cannot be read: nothing is deleted then.
    """
    store.write(CLEARING, now.isoformat().encode())
    try:
        stored: list[Stored] = list(store.files(OBJECTS))
        wanted = {file.object for one in manifests(store, archived(store), advance) for file in one.files}
        gone = [one for one in stored if one.name not in wanted and now - one.written_at > GRACE]
        for one in gone:
            store.delete(one.name)
    finally:
        store.delete(CLEARING)
    return len(gone), sum(one.size for one in gone)


def push_all(
    store: Store,
    places: Sequence[Path],
    *,
    remove: bool,
    tell: Callable[[Pushed | str], None],
    advance: Advance = silent,
) -> tuple[int, int]:
    """Push every finished inspection in some folders and below; what cannot be archived is reported.

    Returns:
        How many are archived, and how many could not be.

    Raises:
        ArchiveError: the archive does not answer.
    """
    check_format(store, begin=True)
    if remove:
        for place in places:
            clear_removed(place)
    done, failed, proven = 0, 0, set[str]()
    signed: list[tuple[str, Signed]] = []
    folders = finished_folders(places)
    for number, folder in enumerate(folders):
        advance("archive", number, len(folders))
        try:
            station, signature = read_record(folder).particulars.station, record_signature(folder)
            tell(push(store, folder, remove=remove, proven=proven))
            if station is not None and signature is not None:
                signed.append((station, signature))
            done += 1
        except ArchiveError:
            raise
        except Exception as error:  # noqa: BLE001 - one folder must not keep the others from the archive
            failed += 1
            tell(" ".join(str(as_foreseen(error, f"archive push, at {folder}")).split()))
    advance("archive", len(folders), len(folders))
    signer = signer_in_use()
    heads = {} if signer is None else noted(signer)[HEADS]
    for line in note_keys(store, signed, {name: HeadNote(**note) for name, note in heads.items()}):
        tell(line)
    if remove:
        for objects in {objects_of(folder) for folder in folders}:
            clear_unused(objects, datetime.now(UTC))
    return done, failed
