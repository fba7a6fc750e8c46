"""Where the numbers of a report come from: groups of names and values, and the files with their hashes."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from pathlib import Path

from anisoscope.calibration.record import CalibrationRecord, Kind
from anisoscope.record.schema import InputFile, PoseRecord, Record, sha256_of
from anisoscope.rig.acquisition.journal import JOURNAL

NOT_STATED = "not stated"


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
    """A time for people, to the second, in a zone that it names; that of this computer if none is given."""
    time = datetime.fromisoformat(text)
    return f"{(time if time.tzinfo else time.replace(tzinfo=UTC)).astimezone(zone):%Y-%m-%d %H:%M:%S %Z}"


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
        ("lot", who.lot or NOT_STATED),
        ("cavity", who.cavity or NOT_STATED),
        ("operator", who.operator or NOT_STATED),
        ("station", who.station or NOT_STATED),
        *(() if who.job is None else (("job", who.job),)),
        *(
            ()
            if who.place_mm is None
            else (("place on the plate", f"{who.place_mm[0]:g} mm, {who.place_mm[1]:g} mm"),)
        ),
        ("inspected", when(record.created_at)),
        ("frames", f"{len(record.frames)}{rounds}"),
        ("software", record.software),
    )


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
        else f"{100 * record.drift:+.2f} % between the first picture and its repetition at the end"
    )
    return (
        ("rig", f"{rig['name']}, SHA-256 {_hash_of(record, 'rig')}"),
        ("stage", record.stage),
        ("camera", f"{record.camera}, {rig['camera']['pixel_um']:g} µm a pixel"),
        ("light", f"{rig['light']['driver']}, {rig['light']['angle_deg']:g}° from the camera"),
        ("drift", drift.replace("-", "−")),
        ("alignment", "; ".join(_alignment(pose) for pose in record.poses) or "–"),
    )


def _alignment(pose: PoseRecord) -> str:
    tilt = f", tilt {pose.tilt_deg:g}°" if pose.tilt_deg else ""
    turned = turn_text(pose.marker_angle_deg - pose.stage_deg)
    return (
        f"{pose.stage_deg:g}°{tilt}: {pose.markers} markers, turned {turned} from the stage's reading, "
        f"{pose.residual_px:.2f} px rms"
    ).replace("-", "−")


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
