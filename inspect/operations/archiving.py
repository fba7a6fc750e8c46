"""Finished inspections on a share or in an object store: sent, fetched, listed, held, and deleted by rules."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.base.user_name import user_name
from anisoscope.inspection import archive
from anisoscope.inspection.archive import Archived, Due, Pushed, Rule
from anisoscope.inspection.archive_store import Store


@dataclass(frozen=True)
class PushedAll:
    """Finished inspections that were sent to an archive.

    Attributes:
        archived: how many are in the archive.
        new: how many of them were not there yet.
        failed: a line for each problem.
        sent_bytes: what was sent; what the archive had is not sent again.
        removed: local folders that were removed.
        refused: how many could not be archived.
    """

    archived: int = 0
    new: int = 0
    failed: tuple[str, ...] = ()
    sent_bytes: int = 0
    removed: int = 0
    refused: int = field(default=0, metadata=LEFT_OUT)

    @classmethod
    def of(cls, told: Sequence[Pushed | str], archived: int = 0, refused: int = 0) -> "PushedAll":
        """Sum over the results of single inspections, also where the archive went away in between."""
        pushed = [one for one in told if isinstance(one, Pushed)]
        return cls(
            archived,
            sum(one.new for one in pushed),
            tuple(one for one in told if isinstance(one, str)),
            sum(one.sent_bytes for one in pushed),
            sum(one.removed for one in pushed),
            refused,
        )


def push(
    store: Store,
    places: Sequence[Path],
    *,
    remove: bool = False,
    told: list[Pushed | str] | None = None,
    on_progress: Advance = silent,
) -> PushedAll:
    """Archive every finished inspection in some folders and below; what is there already is not sent again.

    Args:
        store: of the archive, from `anisoscope.inspection.archive_store.open_store`.
        places: folders; one whose files are not as they were is not archived.
        remove: remove local folders whose files were all read back with right hashes.
        told: receives what became of each inspection as it happens, for `PushedAll.of` after an error.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        ArchiveError: the archive does not answer.
    """
    told = [] if told is None else told
    done, refused = archive.push_all(store, places, remove=remove, tell=told.append, advance=on_progress)
    return PushedAll.of(told, done, refused)


def archived_inspections(
    store: Store, inspection: str | None = None, *, on_progress: Advance = silent
) -> list[Archived]:
    """Manifests of archived inspections: of a serial number, of a folder's name, or all.

    Raises:
        ArchiveError: this is no archive, or it does not answer.
    """
    archive.check_format(store)
    names = archive.archived(store)
    wanted = [name for name in names if inspection is None or archive.fits_name(name, inspection)]
    return list(archive.manifests(store, wanted, on_progress))


def _some(store: Store, inspection: str) -> list[Archived]:
    found = archived_inspections(store, inspection)
    if not found:
        raise UsageError(f"{store.url} holds no inspection of {inspection!r}")
    return found


def pull(store: Store, inspection: str, out: Path, *, on_progress: Advance = silent) -> list[Path]:
    """Fetch inspections from the archive; every file is hashed.

    Args:
        store: of the archive.
        inspection: serial number, or name of an inspection's folder.
        out: folder that receives the inspection folders.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: there is none.
        ArchiveError: the archive does not answer, or a file in it is damaged.
    """
    found, folders = _some(store, inspection), []
    for number, one in enumerate(found):
        on_progress(one.name, number, len(found))
        folders.append(archive.pull(store, one, out))
    return folders


@dataclass(frozen=True)
class Retained:
    """Inspections whose time is over.

    Attributes:
        due: with the rule, and the hold that keeps them.
        deleted: names of those that were deleted.
        objects, bytes: files that nothing needed any longer, which were deleted.
        dry_run: nothing was deleted.
    """

    due: tuple[Due, ...] = field(
        metadata=json_field(
            by=lambda found: [
                {"name": one.inspection.name, "rule": one.rule, "held": one.held} for one in found
            ]
        )
    )
    deleted: tuple[str, ...]
    objects: int
    bytes: int
    dry_run: bool


def retain(
    store: Store, rules: Sequence[Rule], *, dry_run: bool = False, on_progress: Advance = silent
) -> Retained:
    """Delete inspections whose time is over by the rules; those that no rule fits, or that are held, stay.

    Every deletion leaves a note with the whole manifest, the rule, the time and the user.

    Args:
        store: of the archive.
        rules: from `anisoscope.inspection.archive.parse_rule`; the first that fits counts.
        dry_run: only find them.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        ArchiveError: the archive does not answer, a manifest cannot be read, or its clock is another one.
    """
    archive.check_format(store)
    now, deleted, cleared = datetime.now(UTC), [], (0, 0)
    if not dry_run:
        archive.check_clock(store, now)
    found = archive.due(store, rules, now, on_progress)
    if not dry_run:
        for one in found:
            if one.held is None:
                archive.let_go(store, one, user_name(), now)
                deleted.append(one.inspection.name)
        cleared = archive.clear(store, now, on_progress)
    return Retained(tuple(found), tuple(deleted), *cleared, dry_run)


def hold(store: Store, inspection: str, reason: str, *, release: bool = False) -> dict[str, bool]:
    """Put inspections under legal hold, so that no rule deletes them, or end that; a note of either stays.

    Args:
        store: of the archive.
        inspection: serial number, or name of an inspection's folder.
        reason: of the hold, or of its end.
        release: end it.

    Returns:
        Name of each inspection -> whether it is held, or was until now.

    Raises:
        UsageError: no reason, or no such inspection.
        ArchiveError: the archive does not answer.
    """
    if not reason.strip():
        raise UsageError(f"a legal hold {'ends' if release else 'begins'} for a reason: --reason TEXT")
    user, held = user_name(), {}
    for one in _some(store, inspection):
        if release:
            held[one.name] = archive.release(store, one, reason, user)
        else:
            archive.hold(store, one, reason, user)
            held[one.name] = True
    return held
