"""Record of an inspection: measurement, equipment, decision, and the hashes that make it verifiable."""

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, SerializeAsAny, model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError
from anisoscope.base.json_file import parsed_json
from anisoscope.base.last_signed import next_record
from anisoscope.base.printable import check_printable
from anisoscope.base.regular_file import bounded_bytes, regular_file
from anisoscope.base.signature import Signed, read_signed, signed, signer_in_use
from anisoscope.record.details import Details, kind_of_recipe, recorded_kind
from anisoscope.record.display import record_frame, record_html, record_line, record_plot
from anisoscope.record.exclusion import ExclusionRecord
from anisoscope.record.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RECORD_NAME = "record.json"
REPORT_NAME = "report.html"
UNSEALED = "0" * 64
SIGNATURE_NAME = "record.signature.json"
SCHEMA = 2


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class InputFile(_Part):
    """A file that the inspection read or wrote."""

    name: str
    sha256: str


class Particulars(_Part):
    """Operator, lot, cavity, station and job, where stated; (x, y) of the part in mm from the axis of the stage.

    ``job`` is the id under which the controller of a line ordered the inspection.
    """

    operator: str | None = None
    lot: str | None = None
    cavity: str | None = None
    station: str | None = None
    job: str | None = None
    place_mm: tuple[float, float] | None = None

    def checked(self) -> Self:
        """The same, before it enters a new record.

        Raises:
            UsageError: a name holds a sign that cannot be seen, or is too long.
        """
        check_printable(self.model_dump(exclude={"place_mm"}))
        return self


class FrameRecord(InputFile):
    """One frame on disk that the verdict rests on; angles in degrees, exposure in seconds.

    ``again`` marks those that only show drift: after the return to the first pose, or on resuming. ``linear_mm`` are
    the readings of x, y and z, of a rig that has them. ``pixels`` is the SHA-256 of shape and counts, which does not
    depend on how the file packs them.
    """

    kind: str
    again: bool = False
    tilt_deg: float | None = None
    stage_deg: float
    commanded_deg: float
    exposure_s: float
    gain: float
    captured_at: str
    linear_mm: dict[str, float] = Field(default_factory=dict)
    pixels: str = ""


class PoseRecord(_Part):
    """One pose: radiances in 1/sr, where the markers stood, and the ids of those that did not fit the others."""

    stage_deg: float
    tilt_deg: float
    measured: float
    predicted: float
    marker_angle_deg: float
    pixel_um: float
    residual_px: float
    markers: int
    dropped: tuple[int, ...] = ()


class RigPoseRecord(_Part):
    """The rig in one picture, read from the white and black of the fixture's markers.

    ``white`` in 1/sr, ``level`` relative to the reference (to the mean of the poses of this tilt without one),
    ``stray`` radiance in 1/sr beyond that at the reference, ``edge_um`` the standard deviation of the edge spread,
    ``scene`` the mean radiance of the picture.
    """

    stage_deg: float
    tilt_deg: float
    again: bool
    white: float
    level: float
    u_level: float
    black_share: float
    stray: float | None
    u_stray: float
    gradient: float | None
    nonlinear: float | None
    edge_um: float | None
    scene: float = 0.0

    @property
    def stray_share(self) -> float:
        """Stray light relative to the labels, or to the picture where that is brighter."""
        return (self.stray or 0.0) / max(self.white, self.scene)


class RigMonitorRecord(_Part):
    """The rig during an inspection; ``reference`` is the id of the calibration of its fixture.

    ``dirty`` are ids of markers that were left out, ``not_watched`` names what could not be seen.
    """

    reference: str | None
    poses: tuple[RigPoseRecord, ...] = ()
    dirty: tuple[int, ...] = ()
    not_watched: tuple[str, ...] = ()

    @property
    def light_watched(self) -> bool:
        """Whether lamp, exposure and stray light were measured in every pose."""
        return bool(self.poses) and all(pose.stray is not None for pose in self.poses)


class ContrastRecord(_Part):
    """One contrast of a pair of stage angles.

    ``u`` is the standard uncertainty of measured − predicted. ``tolerance``, ``guard`` band and
    ``conformance_probability`` are null without a tolerance, and ``verdict``, of this contrast alone, is PASS then.
    ``p_value`` is Holm-adjusted over all contrasts. ``tolerance_ratio`` is T/U of tolerance and expanded uncertainty
    (k = 2); below 4 good parts often end undecided.
    """

    from_deg: float
    to_deg: float
    tilt_deg: float
    kind: str
    measured: float
    predicted: float
    u: float
    tolerance: float | None
    guard: float | None
    conformance_probability: float | None
    verdict: Verdict
    p_value: float | None = None
    tolerance_ratio: float | None = None

    @property
    def deviation(self) -> float:
        """Measured − predicted."""
        return self.measured - self.predicted


class TiltContrastRecord(_Part):
    """One contrast of a stage angle between the first tilt and another one, for information.

    ``u`` is of measured − predicted, the others are of each alone; ``p_value`` is Holm-adjusted over all of them.
    """

    stage_deg: float
    from_tilt_deg: float
    to_tilt_deg: float
    kind: str
    measured: float
    predicted: float
    u_measured: float
    u_predicted: float
    u: float
    p_value: float


class AreaRecord(_Part):
    """The contrast map judged: share of its cells that deviate, and the standard uncertainty of that share.

    ``limit`` is the score beyond which a cell deviates; None where cells were judged by one ln ratio, or of a print.
    ``cell_deviations`` are ln ratios, one a pair, from about which on a cell deviates that does so in this pair alone;
    ``cell_covariance`` is the (P, P) covariance of ln L of good cells, in which exp(limit) − 1 is the greatest D².
    ``learnt`` if ``max_share`` is that of golden parts, ``p_value`` the chance that a part like them shows as much.
    ``longest_um`` is the length of the longest group of clearly deviating cells, ``longest_at`` its place in mm; both
    None where ``max_length_um``, its limit, is.
    """

    share: float
    u: float
    max_share: float
    cells: int
    verdict: Verdict
    learnt: bool = False
    p_value: float | None = None
    cell_deviations: tuple[float, ...] | None = None
    cell_covariance: tuple[tuple[float, ...], ...] | None = None
    limit: float | None = None
    longest_um: float | None = None
    longest_at: tuple[float, float] | None = None
    max_length_um: float | None = None

    @property
    def too_long(self) -> bool:
        """Whether a mark is longer than its limit."""
        return (
            self.longest_um is not None
            and self.max_length_um is not None
            and self.longest_um > self.max_length_um
        )


class CalibrationUse(InputFile):
    """A calibration that the inspection used; ``name`` is the copy of its record in the folder, times are UTC."""

    kind: str
    id: str
    taken_at: str
    valid_until: str


class BudgetRecord(_Part):
    """One source of uncertainty: its standard contribution to every contrast."""

    source: str
    kind: str
    contributions: tuple[float, ...]


class RegionRecord(_Part):
    """A group of cells that deviate together, in the sample frame at stage angle 0.

    Middle, from the rotation axis, and extents in mm: x and width across the ridges, y and length along them.
    ``area_share`` is its share of the judged area, ``kind`` what it looks like, ``deviation`` the ln ratio by which its
    cells are off on average, of the pair where it shows most, and ``p_value`` the probability that a good part shows a
    group of this size anywhere. ``weights`` are probabilities of the kinds, empty where the shape alone named it.
    """

    x: float
    y: float
    width: float
    length: float
    area_share: float
    cells: int
    kind: str
    deviation: float
    p_value: float
    weights: dict[str, float] = Field(default_factory=dict)


class ComponentRecord(_Part):
    """One of several extents that explain a part together; fields as of `CauseRecord`."""

    cause: str
    title: str
    unit: str
    severity: float
    u: float | None
    interval: tuple[float | None, float | None] | None = None


class CauseRecord(_Part):
    """One cause and how well it explains the part; "nothing" is the part as predicted.

    ``u`` is the standard uncertainty of the severity, null where the data do not determine it. ``interval`` holds the
    severity with 95 %; null for an end that lies beyond what was looked at. ``weight`` is the share of the belief,
    exp(−BIC/2) over all causes, ``chi2`` what remains unexplained; ``at_bound`` if the fit ended at the end of what was
    looked at, ``tie`` if no data separate the cause from the best one. Two causes that act together, and another
    plastic or lamp than the recipe's, have ``components`` with a severity each, and none themselves.
    """

    cause: str
    title: str
    unit: str
    severity: float
    u: float | None
    interval: tuple[float | None, float | None] | None = None
    weight: float
    chi2: float
    at_bound: bool
    tie: bool
    components: tuple[ComponentRecord, ...] = ()


class DiagnosisRecord(_Part):
    """Diagnosis: one line, and the causes, the best first; none where nothing was to be explained.

    ``tells`` names what would separate the tied causes, where that was computed. ``rig_fault`` is the cause that is a
    fault of the rig and explains a failing part as well as the best defect, ``verdict`` what the part gets then.
    """

    says: str
    causes: tuple[CauseRecord, ...] = ()
    unexplained_p: float | None = None
    tells: str | None = None
    rig_fault: str | None = None
    verdict: Verdict | None = None


class ConclusionRecord(_Part):
    """The verdict in plain words, for the shop.

    ``finding`` names what was found with its size, ``action`` what to do next, ``follows_from`` the cause or outcome
    to which the action belongs: the key by which ``[actions]`` of a recipe overrides it.
    """

    finding: str
    action: str
    follows_from: str


class ComparisonRecord(_Part):
    """The measurement against one of the recipe's surfaces; predicted radiances in 1/sr."""

    surface: str
    decides: bool
    model: str
    predicted: tuple[float, ...]
    d2: float
    dof: int
    p_value: float
    agrees: bool


class ReadingNumberRecord(_Part):
    """A number of a reading: what was found, with its standard uncertainty, and what it is compared with."""

    name: str
    unit: str
    value: float
    u: float
    expected: float


class ReadingRecord(_Part):
    """One of the four readings of a recipe with both surfaces: what was compared, whether it agrees, and in words.

    ``reading`` is "measured-design", "measured-map", "map-design" (both predictions) or "geometry" (the ridges of the
    map against the design). ``agrees`` is null, and ``p_value`` too, where it could not be read; ``says`` tells why.
    """

    reading: str
    title: str
    says: str
    agrees: bool | None
    d2: float | None
    dof: int | None
    p_value: float | None
    numbers: tuple[ReadingNumberRecord, ...] = ()


class EstimateRecord(_Part):
    """A fitted parameter; without a value the poses do not determine it."""

    name: str
    title: str
    unit: str
    value: float | None
    u: float | None
    at_bound: bool


class OpticsRecord(_Part):
    """By rays or by waves, and why.

    ``stated_error`` is that of the model that was taken, as a share of the middle of the brightest lobe; ``asked`` is
    what the recipe says. None stands for what has no end, or was not known: a map with missing points. ``bounces`` is
    the largest number of reflections that was followed, ``reflections_from`` whether on a "groove" of ideal facet and
    wall, of which angle, or on "paths on the height map", and for what reason.
    """

    asked: str
    model: str
    reason: str
    stated_error: float | None
    stated_error_per_sr: float | None
    f_um: float | None
    coherence_um: float | None
    wavelengths_nm: tuple[float, ...] = ()
    bounces: int | Literal["all"] | None = None
    reflections_from: str | None = None
    reflections_reason: str | None = None
    groove_angle_deg: float | None = None
    groove_wall: str | float | None = None


class ShapeRecord(_Part):
    """Ideal ridges fitted to the contrasts over several tilts; ``held`` were not free."""

    estimates: tuple[EstimateRecord, ...]
    held: tuple[str, ...]
    chi2: float
    dof: int
    p_value: float | None
    advice: str | None


class DirectionRecord(_Part):
    """Test of the part for one named defect against golden parts.

    ``score`` in standard deviations of good parts, ``separation`` its mean for a part with the smallest interesting
    defect, ``power`` the probability of finding that one, ``detectable`` the multiple of its size that is found in 9 of
    10 parts, null where none is. ``p_value`` is that of the score for a good part, adjusted for the other
    tests; null in older records.
    """

    defect: str
    score: float
    separation: float
    power: float
    detectable: float | None
    p_value: float | None = None


class GoldenRecord(_Part):
    """The golden parts that decided what deviates: ln ratios to the first pose, one row a part.

    ``birge`` is the variance among the golden parts over the stated one, ``size`` what the test takes it to be, null in
    older records, ``batches`` the number of their lots or days, ``unjudged`` the number of parts of a lot of unknown
    quality, ``lot`` the lot where they are its other parts; ``p_distance`` and ``p_direction`` are the p values of the
    squared distance and of the scores of ``directions``; ``test`` is the one that decided, "predictive" by the stated
    scatter, "sized" by one of the form of the budget, "hotelling" (earlier versions) by that of the golden parts alone.
    """

    parts: int
    mean: tuple[float, ...]
    contrasts: tuple[tuple[float, ...], ...]
    measured: tuple[float, ...]
    birge: float | None = None
    p_distance: float | None = None
    p_direction: float | None = None
    directions: tuple[DirectionRecord, ...] = ()
    test: Literal["predictive", "sized", "hotelling"] = "hotelling"
    size: float | None = None
    batches: int | None = None
    unjudged: int = 0
    lot: Annotated[str | None, Field(exclude_if=lambda lot: lot is None)] = None

    @property
    def words(self) -> str:
        """Name of the parts in a report."""
        return "golden parts" if self.lot is None else f"other parts of lot {self.lot}"


class MapPlaceRecord(_Part):
    """Position of the middle of the height map from the middle of the region: x across the ridges, y along them.

    ``phase_um`` is x within ± half a pitch. Where the place is resolved, ``measured`` and ``predicted`` are mean
    radiances in 1/sr of the poses of the first tilt over the share of the region that the map covers as well; they do
    not enter the verdict.
    """

    x_um: float | None
    y_um: float | None
    phase_um: float
    correlation: float
    ratio: float
    resolved: bool
    says: str
    shared_share: float | None = None
    measured: tuple[float, ...] = ()
    predicted: tuple[float, ...] = ()


class RidgeLeanRecord(_Part):
    """Lean of the facet of one ridge across the ridges; place from the rotation axis, ``u_deg`` against the part."""

    ridge: int
    x: float
    y: float
    angle_deg: float
    u_deg: float


class FormRecord(_Part):
    """Largest lean of the facets over several ridges, in degrees about the plane through all of them, and its limit.

    Place in mm on the sample. ``depth_um`` is that of the form there, from the lean across the ridges, negative where
    it stands out, 0 where only one flank of it is seen.
    """

    lean_deg: float
    u_deg: float
    max_lean_deg: float
    x: float
    y: float
    depth_um: float
    verdict: Verdict


class AngleRecord(_Part):
    """Lean of the facets in cells of ``cell_um`` (across and along the ridges), from the photographs.

    ``spread_deg`` is the standard deviation between cells without that of their measurement, ``along_deg`` the mean
    lean along the ridges, null where no pose tells it. ``alpha`` is the roughness of the part over that of the recipe.
    In ``unseen_share`` of the cells no lean explains the light. It informs and does not decide.
    """

    mean_deg: float
    u_mean_deg: float
    spread_deg: float
    u_cell_deg: float
    along_deg: float | None
    alpha: float
    u_alpha: float
    cell_um: tuple[float, float]
    cells: int
    unseen_share: float
    worst: RidgeLeanRecord | None


class Record(_Part):
    """An inspection, complete; ``recipe`` and ``rig`` hold the files as they were.

    ``details`` holds what is of its ``kind`` of part alone; None where that could not be judged. The schema only grows:
    fields that came later have defaults, which stand for "not recorded" (`json_schema`).

    ``origin`` says whether the rig took the frames or they were imported; ``reuse`` is the reason given for judging
    frames that are already known as those of another part; ``judged_anew`` names an earlier record of the same frames.

    ``files`` lists everything else in the folder but the report. ``record.json`` is written after all of them, so that
    where it is, they are. The report follows, with a seal of its own (``report.sha256``); records of earlier versions
    list it.
    """

    schema_version: Annotated[Literal[2], Field(alias="schema")] = 2
    kind: str
    software: str
    created_at: str
    serial: str
    particulars: Particulars = Particulars()
    product: str
    verdict: Literal["PASS", "FAIL", "INCONCLUSIVE", "INVALID"]
    reasons: tuple[str, ...]
    model: str
    optics: OpticsRecord | None = None
    convention: dict[str, Any]
    poses: tuple[PoseRecord, ...]
    d2: float | None
    dof: int | None
    p_value: float | None
    budget: tuple[BudgetRecord, ...]
    drift: float | None
    rig_monitor: RigMonitorRecord | None = None
    conformance_probability: float | None = None
    diagnosis: DiagnosisRecord | None = None
    conclusion: ConclusionRecord | None = None
    details: SerializeAsAny[Details] | None = None
    rounds: int = 1
    notes: tuple[str, ...] = ()
    white_reference: dict[str, Any]
    calibrations: tuple[CalibrationUse, ...] = ()
    recipe: dict[str, Any]
    rig: dict[str, Any]
    camera: str
    stage: str
    origin: Literal["", "rig", "imported"] = ""
    reuse: str = ""
    judged_anew: Annotated[str, Field(exclude_if=lambda text: not text)] = ""
    inputs: tuple[InputFile, ...]
    frames: tuple[FrameRecord, ...]
    files: tuple[InputFile, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _details_of_the_kind(cls, record: Any) -> Any:  # noqa: ANN401
        if isinstance(record, dict) and isinstance(record.get("details"), dict):
            details = recorded_kind(str(record.get("kind"))).details.model_validate(record["details"])
            return {**record, "details": details}
        return record

    @property
    def exclusions(self) -> tuple[ExclusionRecord, ...]:
        """Limits of the named defects; none of a part that deviates, or could not be judged."""
        return () if self.details is None else self.details.exclusions

    def __repr__(self) -> str:
        """One line: serial number, product, verdict, the first reason."""
        return f"Record({record_line(self)})"

    def __str__(self) -> str:
        """The same line: what ``print`` shows."""
        return repr(self)

    def _repr_html_(self) -> str:
        return record_html(self)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw measured and predicted radiances against the stage angle.

        Args:
            axes: of matplotlib, to draw into; a new figure where they are not given.
        """
        return record_plot(self, axes)

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """The poses as a pandas data frame: stage angle, tilt, measured and predicted radiance in 1/sr.

        Raises:
            UsageError: pandas is not installed.
        """
        return record_frame(self)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with regular_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_record(record: Record, folder: Path) -> Path:
    """Write ``record.json``, all or nothing, and before it its signature where a signing key is in use.

    The file ends with its seal: the SHA-256 of its own bytes with zeros in place of the seal. What is signed links the
    record to the one before it (`next_record`).

    Raises:
        ConfigError: the signing key cannot be used.
    """
    path = folder / RECORD_NAME
    content = record.model_dump(mode="json", by_alias=True) | {"seal": UNSEALED}
    text = json.dumps(content, indent=2, allow_nan=False)
    seal = hashlib.sha256(text.encode()).hexdigest()
    whole = _with_seal(text, seal)
    signer = signer_in_use()
    if signer is not None:
        names = "serial", "product", "verdict", "created_at", "software", "origin"
        statement = {"record": hashlib.sha256(whole.encode()).hexdigest()}
        statement |= {name: content[name] for name in names}
        statement |= {"judged_anew": record.judged_anew}
        statement |= {name: content["particulars"][name] for name in ("lot", "station")}
        with next_record(signer, folder, seal) as link:
            write_text(folder / SIGNATURE_NAME, signed("record", statement | link, signer) + "\n")
            write_text(path, whole)
    else:
        (folder / SIGNATURE_NAME).unlink(
            missing_ok=True
        )  # of an attempt with a key that was killed before its record
        write_text(path, whole)
    return path


_ALSO_SIGNED = frozenset(
    {
        "serial",
        "product",
        "verdict",
        "created_at",
        "software",
        "origin",
        "judged_anew",
        "reuse",
        "lot",
        "station",
    }
)
"""Fields of a record that its signed statement names as well."""


def record_signature(folder: Path) -> Signed | None:
    """The signature of a record, checked with the key that it names; None where the record is not signed.

    Raises:
        RecordError: it is damaged, or that of another record.
    """
    path = folder / SIGNATURE_NAME
    try:
        if not path.exists():
            return None
        found = read_signed("record", bounded_bytes(path))
        if found.content.get("record") != sha256_of(folder / RECORD_NAME):
            raise ValueError("it is the signature of another record, or the record was changed")
        content, _ = _content_of(folder / RECORD_NAME)
        for name in _ALSO_SIGNED & found.content.keys():
            recorded = content.get(name, (content.get("particulars") or {}).get(name, ""))
            if found.content[name] != recorded:
                raise ValueError(f"it says another {name} than the record")
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RecordError(f"{path}: {error}") from None
    return found


def read_record(folder: Path | str) -> Record:
    """Read the record of an inspection folder.

    Raises:
        RecordError: there is none, it is damaged or was changed, or a later version wrote it.
    """
    path = Path(folder) / RECORD_NAME
    content, _ = _content_of(path)
    try:
        if isinstance(content, dict):
            content = upgraded(content)
    except RecordError as problem:
        raise RecordError(f"{path}: {problem}") from problem
    later = _later(content)
    if later is not None:
        raise RecordError(f"{path} was written by a later version of anisoscope ({later}): update anisoscope")
    try:
        if isinstance(content, dict) and isinstance(content.get("kind"), str):
            recorded_kind(content["kind"])  # also where there are no details
        return Record.model_validate_json(json.dumps(content))
    except RecordError as problem:
        raise RecordError(f"{path}: {problem}") from problem
    except ValueError as error:
        raise RecordError(f"{path} is damaged: {str(error).splitlines()[0]}") from error


def recorded_files(folder: Path) -> tuple[InputFile, ...]:
    """Files that the record of an inspection folder lists; its kind of part need not be installed.

    Raises:
        RecordError: there is no record, or it is damaged or was changed.
    """
    path = folder / RECORD_NAME
    content, sealed = _content_of(path)
    if not sealed:  # then only its fields show whether it is whole
        return read_record(folder).files
    try:
        return tuple(InputFile.model_validate(file) for file in content.get("files", ()))
    except (TypeError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {str(error).splitlines()[0]}") from error


def recorded_origin(folder: Path) -> tuple[str, str]:
    """Origin of the frames, "rig" or "imported" ("" in older records), and the earlier record of the same frames.

    Raises:
        RecordError: there is no record, or it is damaged or was changed.
    """
    content, _ = _content_of(folder / RECORD_NAME)
    return str(content.get("origin", "")), str(content.get("judged_anew", ""))


def _content_of(path: Path) -> tuple[Any, bool]:
    """Content of the file of a record without its seal, and whether it bears one."""
    try:
        text = bounded_bytes(path).decode()
        content = parsed_json(text)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}: was this inspection finished?") from error
    except ValueError as error:
        raise RecordError(f"{path} is damaged: {str(error).splitlines()[0]}") from error
    seal = content.pop("seal", None) if isinstance(content, dict) else None
    if seal is not None and seal != _seal_of(text, str(seal)):
        raise RecordError(f"{path} is damaged: it was changed after it had been written")
    return content, seal is not None


def _later(content: object) -> str | None:
    """Fields of a record that this version does not know."""
    if not isinstance(content, dict):
        return None
    schema = content.get("schema", SCHEMA)
    if isinstance(schema, int) and schema > SCHEMA:
        return f"schema {schema}"
    known = {field.alias or name for name, field in Record.model_fields.items()}
    unknown = sorted(content.keys() - known)
    return f"it holds {', '.join(unknown)}" if unknown and content.get("software") else None


def _with_seal(text: str, seal: str) -> str:
    before, _, after = text.rpartition(UNSEALED)
    return before + seal + after


def _seal_of(text: str, seal: str) -> str:
    before, _, after = text.rpartition(seal)
    return hashlib.sha256((before + UNSEALED + after).encode()).hexdigest()


def upgraded(content: dict[str, Any]) -> dict[str, Any]:
    """A parsed record of schema 1 as one of schema 2; other records as they are.

    Fields that the older version lacked stay absent, so that recomputing does not compare them.

    Raises:
        RecordError: the kind of part that it is of is not installed.
    """
    if content.get("schema", 1) != 1 or "kind" in content:
        return content
    found, recipe = dict(content), content.get("recipe")
    kind = kind_of_recipe(recipe if isinstance(recipe, dict) else {})
    details = recorded_kind(kind).details.of_schema_1(found)
    # schema 1 had the fields of all kinds side by side; those of other kinds are empty
    known = {name for name, value in found.items() if value not in (None, [])} | _MAY_BE_EMPTY
    return {name: value for name, value in found.items() if name in known} | {
        "schema": 2,
        "kind": kind,
        "details": details,
    }


_MAY_BE_EMPTY = frozenset(
    {
        "poses",
        "budget",
        "optics",
        "calibrations",
        "notes",
        "inputs",
        "frames",
        "files",
        "reasons",
        "d2",
        "dof",
        "p_value",
        "drift",
        "conformance_probability",
        "diagnosis",
    }
)
