"""Where the numbers of a report come from: groups of names and values, and the files with their hashes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from pathlib import Path

from anisoscope.base.notation import true_minus
from anisoscope.calibration.record import CalibrationRecord, Kind
from anisoscope.record.schema import (
    InputFile,
    PoseRecord,
    Record,
    RigMonitorRecord,
    RigPoseRecord,
    sha256_of,
)
from anisoscope.rig.acquisition.journal import JOURNAL


@dataclass(frozen=True)
class Group:
    """Names and values under one heading."""

    title: str
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class CalibrationRow:
    """One calibration; fields that its record lacks are empty."""

    kind: str
    id: str
    taken: str
    valid_until: str
    sha256: str


def when(text: str, zone: tzinfo | None = None) -> str:
    """A time for people, to the second, in a zone that it names, with UTC in brackets; by default the local zone."""
    time = datetime.fromisoformat(text)
    local = (time if time.tzinfo else time.replace(tzinfo=UTC)).astimezone(zone)
    utc = local.astimezone(UTC)
    day = "" if utc.date() == local.date() else f"{utc:%Y-%m-%d} "
    return f"{local:%Y-%m-%d %H:%M:%S %Z}" + (f" ({day}{utc:%H:%M} UTC)" if local.utcoffset() else "")


def turn_text(value: float) -> str:
    """A small turn in degrees, signed, without a negative zero."""
    turn = round((value + 180.0) % 360.0 - 180.0, 2) + 0.0
    return f"{turn:+.2f}°".replace("-", "−")


def groups_of(record: Record) -> tuple[Group, ...]:
    """Part, recipe, rig and software of a record in rows."""
    return (
        Group("Part and inspection", _inspection(record)),
        Group("Recipe and prediction", _recipe(record)),
        Group("Rig", _rig(record)),
    )


def _inspection(record: Record) -> tuple[tuple[str, str], ...]:
    who = record.particulars
    rounds = "" if record.rounds == 1 else f" in {record.rounds} rounds"
    return (
        ("serial number", record.serial),
        ("product", record.product),
        *(
            (name, value)
            for name in ("lot", "cavity", "operator", "station", "job")
            if (value := getattr(who, name)) is not None
        ),
        *(
            ()
            if who.place_mm is None
            else (("place on the plate", f"{who.place_mm[0]:g} mm, {who.place_mm[1]:g} mm"),)
        ),
        ("inspected", when(record.created_at)),
        ("frames", f"{len(record.frames)}{rounds}{_origin(record)}"),
        ("software", record.software),
    )


def _origin(record: Record) -> str:
    """Origin of the frames, in words; empty for older records."""
    words = {"rig": ", taken by the rig", "imported": ", imported", "": ""}[record.origin]
    words += f", known as those of another part: {record.reuse}" if record.reuse else ""
    return f"{words}, judged anew after {record.judged_anew}" if record.judged_anew else words


def _recipe(record: Record) -> tuple[tuple[str, str], ...]:
    recipe, rule = record.recipe, record.recipe["decision"]
    acquisition, convention = recipe["acquisition"], record.convention
    brackets = ", ".join(f"{factor:g}" for factor in acquisition.get("brackets", ()))
    exposed = f"{1000 * acquisition['exposure_s']:g} ms" + (
        f" and {brackets} times as long" if brackets else ""
    )
    predicted = (
        f"model {record.model}; light {convention['light_angle_deg']:g}° from the camera, tilt plane "
        f"{convention['tilt_plane']}, facets toward {convention['facet_azimuth_deg']:g}°, stage turns "
        f"{convention['rotation_sense']}, k = 1 (white tile)"
    )
    return (
        ("recipe", f"version {recipe['version']}, SHA-256 {_hash_of(record, 'recipe')}"),
        ("decision", f"α = {rule['alpha']:g}, guard band {rule['coverage']:g} u"),
        (
            "exposure",
            f"{exposed} at gain {acquisition['gain']:g}, {acquisition['frames_per_pose']} frames a pose",
        ),
        ("prediction", predicted if record.model else "–"),
    )


def _hash_of(record: Record, name: str) -> str:
    found = (file.sha256 for file in record.inputs if Path(file.name).stem == name)
    return next(found, "–")


def _rig(record: Record) -> tuple[tuple[str, str], ...]:
    rig = record.rig
    drift = (
        "not measured"
        if record.drift is None
        else f"{100 * record.drift:+z.2f} % between the first picture and its repetition at the end"
    )
    return (
        ("rig", f"{rig['name']}, SHA-256 {_hash_of(record, 'rig')}"),
        ("stage", record.stage),
        ("camera", f"{record.camera}, {rig['camera']['pixel_um']:g} µm a pixel"),
        ("light", f"{rig['light']['driver']}, {rig['light']['angle_deg']:g}° from the camera"),
        ("drift", drift.replace("-", "−")),
        ("alignment", _alignment(record.poses)),
    )


def _alignment(poses: Sequence[PoseRecord]) -> str:
    """How all poses were aligned; each of them is in the record."""
    if not poses:
        return "–"
    turns = [(pose.marker_angle_deg - pose.stage_deg + 180.0) % 360.0 - 180.0 for pose in poses]
    return (
        f"at least {min(pose.markers for pose in poses)} markers in each of {len(poses)} poses, turned "
        f"{turn_text(min(turns))} to {turn_text(max(turns))} from the stage's reading, at most "
        f"{max(pose.residual_px for pose in poses):.2f} px rms"
    )


def calibrations_of(
    record: Record, calibrations: Mapping[Kind, CalibrationRecord]
) -> tuple[CalibrationRow, ...]:
    """Every calibration that the inspection rests on; the white reference always."""
    white = record.white_reference
    known = calibrations.get("flat")
    rows = [
        CalibrationRow(
            f"white reference, reflectance {white['reflectance']:g}",
            known.id if known else "–",
            when(white["taken_at"]),
            when(known.valid_until.isoformat()) if known else "–",
            white["sha256"],
        )
    ]
    for kind, one in calibrations.items():
        if kind != "flat":
            taken, until = when(one.taken_at.isoformat()), when(one.valid_until.isoformat())
            rows.append(CalibrationRow(kind, one.id, taken, until, _hash_of(record, kind)))
    return tuple(rows)


def files_of(record: Record, folder: Path) -> tuple[InputFile, ...]:
    """Input files and the journal of the frames, with their hashes.

    Args:
        record: the inspection.
        folder: its folder; a journal that is not there is left out.
    """
    journal = folder / JOURNAL
    if not journal.is_file():
        return record.inputs
    return (*record.inputs, InputFile(name=JOURNAL, sha256=sha256_of(journal)))


WIDTH, HEIGHT, MARGIN = 240.0, 70.0, 8.0


@dataclass(frozen=True)
class Trace:
    """One reading over the poses, drawn in a box of `WIDTH` by `HEIGHT`.

    Attributes:
        title: reading, unit and range.
        points: (x, y) of every picture in the box, with its value in words.
        limits: y of the limits that lie in the box.
    """

    title: str
    points: tuple[tuple[float, float, str], ...]
    limits: tuple[float, ...]

    @property
    def line(self) -> str:
        """The points as SVG writes them."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in self.points)


@dataclass(frozen=True)
class RigSection:
    """The rig during an inspection: sentences for the operator, and traces; none without markers."""

    says: tuple[str, ...]
    traces: tuple[Trace, ...] = ()
    width: float = WIDTH
    height: float = HEIGHT


def rig_section(record: Record) -> RigSection | None:
    """The section of a record; None of inspections without a monitor."""
    monitor = record.rig_monitor
    if monitor is None:
        return None
    if not monitor.poses:
        return RigSection(_lacking(monitor))
    limits = record.recipe["limits"]
    level_limit = 100.0 * limits.get(
        "white_untaught_share" if monitor.reference is None else "white_share", 0.0
    )
    usual = sum(pose.level for pose in monitor.poses) / len(monitor.poses)
    traces = [
        _trace(
            "lamp and exposure [%]",
            "+z.2f",
            monitor,
            lambda pose: 100.0 * (pose.level / usual - 1.0),
            level_limit,
        )
    ]
    if monitor.reference is not None:
        limit = 100.0 * limits.get("stray_share", 0.0)
        traces.append(
            _trace(
                "stray light [% of white]",
                "z.2f",
                monitor,
                lambda pose: 100.0 * pose.stray_share,
                limit,
            )
        )
    traces.append(_trace("black [% of white]", ".2f", monitor, lambda pose: 100.0 * pose.black_share))
    if all(pose.edge_um is not None for pose in monitor.poses):
        traces.append(_trace("edge width [µm]", ".1f", monitor, lambda pose: pose.edge_um or 0.0))
    return RigSection((*_says(monitor, usual), *_lacking(monitor)), tuple(traces))


def _says(monitor: RigMonitorRecord, usual: float) -> tuple[str, ...]:
    spread = max(abs(pose.level / usual - 1.0) for pose in monitor.poses)
    found = [f"Lamp and exposure were equal within {spread:.2%} over the poses"]
    if monitor.reference is not None:
        stray = max(abs(pose.stray_share) for pose in monitor.poses)
        found[0] += (
            f", at {usual:.1%} of the reference {monitor.reference}; the pictures are corrected for it."
        )
        found.append(
            f"Stray light was within {stray:.2%} of white of that at the reference, and is subtracted."
        )
    else:
        found[0] += "."
    if monitor.dirty:
        names = ", ".join(map(str, monitor.dirty))
        found.append(f"Left out as dirty or in shadow: marker {names}. Clean the fixture.")
    return tuple(found)


def _lacking(monitor: RigMonitorRecord) -> tuple[str, ...]:
    return tuple(f"Not watched: {one}." for one in monitor.not_watched)


def _trace(
    title: str,
    form: str,
    monitor: RigMonitorRecord,
    value: Callable[[RigPoseRecord], float],
    limit: float | None = None,
) -> Trace:
    values = [value(pose) for pose in monitor.poses]
    low, high = min(values), max(values)
    title = true_minus(f"{title}: {low:{form}} to {high:{form}}")
    if limit is not None:
        low, high = min(low, -limit), max(high, limit)
    room = max(high - low, 0.2 * abs(high), 1e-6)
    middle = 0.5 * (low + high)

    def down(number: float) -> float:
        return HEIGHT / 2.0 - (number - middle) / room * (HEIGHT - 2.0 * MARGIN)

    step = (WIDTH - 2.0 * MARGIN) / max(len(values) - 1, 1)
    points = tuple(
        (
            MARGIN + k * step,
            down(number),
            true_minus(f"{pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°: {number:{form}}"),
        )
        for k, (pose, number) in enumerate(zip(monitor.poses, values, strict=True))
    )
    return Trace(title, points, () if limit is None else (down(limit), down(-limit)))
