"""``job.json`` and ``inputs/``: what an inspection was started with, so that its folder explains itself."""

import hashlib
import json
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import AnisoscopeError, RecordError, UsageError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.calibration.corrections import calibrations_of
from anisoscope.calibration.white_reference import read_reference
from anisoscope.inspection.folder import INPUTS, JOB
from anisoscope.inspection.job import LOT, Job, Role, Source, fixture_of
from anisoscope.inspection.objects import LARGE, store
from anisoscope.kinds.parts import References
from anisoscope.kinds.registry import kind_of
from anisoscope.recipe.logo import LOGO, with_logo
from anisoscope.record.schema import InputFile, Particulars, sha256_of
from anisoscope.rig.acquisition.plan import Plan
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.rigfile import CalibrationPart, read_replay_rig, read_rig


class InputCopy(InputFile):
    """Copy of an input file in the inspection folder; ``original`` is the path of the input."""

    role: Role
    original: str


class Manifest(BaseModel):
    """``job.json``.

    Attributes:
        software: what wrote it.
        created_at: UTC time.
        serial: serial number of the part.
        particulars: who inspects which lot where, as far as it was said.
        origin: whether a rig takes the frames, or a folder of frames is replayed.
        plan: what is photographed; None for a replay.
        frames: number of frames of a whole inspection.
        rig_folder: where the rig file lay, which its ``${here}`` stands for.
        inputs: copies of the files.
        refused: why the part is INVALID without being judged, such as a code that is not its own.
        reuse: reason given for judging frames that are already known as those of another part.
        judged_anew: earlier record of the same frames, in words; empty where there is none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    software: str
    created_at: str
    serial: str
    particulars: Particulars = Particulars()
    origin: Literal["rig", "frames"]
    plan: Plan | None
    frames: int
    rig_folder: str
    inputs: tuple[InputCopy, ...]
    refused: str | None = None
    reuse: str = ""
    judged_anew: str = ""

    @property
    def began(self) -> datetime:
        """When the inspection began, UTC."""
        return datetime.fromisoformat(self.created_at)

    def input(self, role: Role) -> InputCopy | None:
        """The copy of the file of a role, or None."""
        return next((copy for copy in self.inputs if copy.role == role), None)


def begin(
    folder: Path,
    job: Job,
    particulars: Particulars,
    *,
    plan: Plan | None,
    frames: int,
    rig_folder: Path,
    refused: str | None = None,
    reuse: str = "",
    share: bool = False,
) -> Manifest:
    """Copy the files of a job into ``inputs/`` and write ``job.json``, which makes the folder one to be resumed.

    Args:
        folder: of the inspection, or a temporary one.
        job: what is inspected.
        particulars: who inspects which lot where.
        plan: what is photographed; None for a replay.
        frames: number of frames of a whole inspection.
        rig_folder: where the rig file is.
        refused: why the part is INVALID without being photographed.
        reuse: reason for judging frames that are known as those of another part.
        share: large files are on the disk once for all inspections next to this one (`anisoscope.inspection.objects`).

    Raises:
        RecordError: the folder cannot be written.
        UsageError: a file was changed since it was read.
    """
    manifest = Manifest(
        software=f"anisoscope {version('anisoscope')}",
        created_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
        serial=job.serial,
        particulars=particulars,
        origin="frames" if plan is None else "rig",
        plan=plan,
        frames=frames,
        rig_folder=str(rig_folder.resolve()),
        inputs=tuple(_copy(source, folder, share=share) for source in job.sources),
        refused=refused,
        reuse=reuse,
    )
    write_manifest(manifest, folder)
    return manifest


def one_round_more(folder: Path, manifest: Manifest) -> Manifest:
    """Write down that all poses are photographed once more, before they are, so that this can be resumed as well.

    Raises:
        RecordError: the folder cannot be written.
    """
    assert manifest.plan is not None
    plan = replace(manifest.plan, rounds=manifest.plan.rounds + 1)
    more = manifest.model_copy(update={"plan": plan, "frames": plan.frame_count})
    write_manifest(more, folder)
    return more


def refuse(folder: Path, manifest: Manifest, reason: str) -> Manifest:
    """Write down why photographs make a part INVALID without being judged.

    Raises:
        RecordError: the folder cannot be written.
    """
    refused = manifest.model_copy(update={"refused": reason})
    write_manifest(refused, folder)
    return refused


def write_manifest(manifest: Manifest, folder: Path) -> None:
    """Write ``job.json``.

    Raises:
        RecordError: the folder cannot be written.
    """
    write_text(folder / JOB, json.dumps(manifest.model_dump(mode="json", by_alias=True), indent=2) + "\n")


def _copy(source: Source, folder: Path, *, share: bool) -> InputCopy:
    # The table of a replay describes the frames of its own folder.
    target = folder / (FRAMES if source.role == "frame table" else INPUTS) / source.path.name
    in_place = source.path == target
    if target.exists() and not in_place:
        target = target.with_name(f"{source.role.replace(' ', '-')}-{source.path.name}")
    copy = InputCopy(
        role=source.role,
        name=target.relative_to(folder).as_posix(),
        sha256=source.sha256,
        original=str(source.path.resolve()),
    )
    try:
        target.parent.mkdir(exist_ok=True)
        content = bounded_bytes(source.path, MOST_PICTURE_BYTES)
        if hashlib.sha256(content).hexdigest() != source.sha256:
            raise UsageError(f"{source.path} was changed while the inspection began: start it again")
        if share and len(content) >= LARGE:
            store(content, copy, folder)
        elif not in_place:
            target.write_bytes(content)
    except OSError as error:
        raise RecordError(f"cannot copy {source.path} to {target}: {error.strerror}") from error
    return copy


MOST_NAMED = 3


def read_job_file(folder: Path) -> Manifest:
    """Read ``job.json``.

    Raises:
        RecordError: there is none, or it is damaged.
    """
    path = folder / JOB
    try:
        return Manifest.model_validate_json(bounded_bytes(path))
    except OSError as error:
        what = "no inspection of this version began here" if folder.is_dir() else "there is no such folder"
        inside = sorted(job.parent.name for job in folder.glob(f"*/{JOB}"))[-MOST_NAMED:]
        if inside:
            what += f", but in folders of it: name one, such as {', '.join(inside)}"
        raise RecordError(f"{folder}: {what} ({path.name}: {error.strerror})") from error
    except (ValidationError, AnisoscopeError) as error:
        raise RecordError(f"{path} is damaged: {str(error).splitlines()[0]}") from error


def reopen(folder: Path, channel: str | None = None) -> tuple[Manifest, Job]:
    """The job of an inspection folder, from its own copies alone.

    Raises:
        RecordError: ``job.json`` or a copy is missing, damaged or was changed.
        RecipeError, RigFileError, CalibrationError: a copy that this version cannot use.
    """
    manifest = read_job_file(folder)
    paths = {copy.role: checked(copy, folder) for copy in manifest.inputs}
    missing = {"recipe", "rig", "white reference"} - paths.keys()
    if missing:
        raise RecordError(f"{folder / JOB} is damaged: it names no {min(missing)}")
    kind = kind_of(paths["recipe"])
    recipe = kind.read_copy(paths["recipe"], paths)
    here = Path(manifest.rig_folder)
    channel = channel or recipe.acquisition.light_channel
    rig = (
        read_rig(paths["rig"], here=here, channel=channel)
        if manifest.origin == "rig"
        else read_replay_rig(paths["rig"], channel)
    )
    rig = rig.model_copy(update={"calibration": CalibrationPart(flat=paths["white reference"])})
    recipe, rig = kind.from_copies(recipe, rig, paths)
    recipe = with_logo(recipe, paths.get(LOGO))
    white = read_reference(paths["white reference"])
    sources = tuple(Source(copy.role, folder / copy.name, copy.sha256) for copy in manifest.inputs)
    known = paths.get("golden parts") or paths.get(LOT)
    reference = None
    if known is not None and isinstance(kind, References):
        reference = kind.read_reference(known, recipe)
    calibrations = replace(calibrations_of(paths), followed=rig.x is not None and rig.y is not None)
    white, fixture = calibrations.white(white), fixture_of(rig, paths["rig"])
    return manifest, Job(manifest.serial, kind, recipe, rig, fixture, white, sources, reference, calibrations)


def checked(file: InputFile, folder: Path) -> Path:
    """The path of a file of an inspection folder whose hash is what it was.

    Raises:
        RecordError: it is missing or was changed.
    """
    path = folder / file.name
    try:
        found = sha256_of(path)
    except OSError as error:
        raise _unreadable(path, error) from error
    if found != file.sha256:
        raise _changed(path)
    return path


def checked_content(file: InputFile, folder: Path) -> bytes:
    """The bytes of a file of an inspection folder, read once; errors as of `checked`."""
    path = folder / file.name
    try:
        content = bounded_bytes(path, MOST_PICTURE_BYTES)
    except OSError as error:
        raise _unreadable(path, error) from error
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise _changed(path)
    return content


def _unreadable(path: Path, error: OSError) -> RecordError:
    return RecordError(f"{path}: cannot be read: {error.strerror}; it belongs to this inspection")


def _changed(path: Path) -> RecordError:
    return RecordError(
        f"{path}: was changed since the inspection (its SHA-256 differs): inspect the part anew"
    )
