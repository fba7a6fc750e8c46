"""The bench file: sample and imperfections of the virtual rig."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from anisoscope.base.errors import ModelError, RigFileError, UsageError
from anisoscope.base.toml_file import (
    LocalPath,
    NameOrFile,
    NotNegative,
    Part,
    Positive,
    Share,
    read_toml_model,
)
from anisoscope.rig.bayer import Filters
from anisoscope.rig.fixture import Fixture
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.fw102c import PLACES
from anisoscope.sim.bench.plate import PlatePart
from anisoscope.sim.bench.printpart import PrintPart
from anisoscope.sim.bench.waferpart import WaferPart
from anisoscope.sim.light.colour.vision import Vision
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities
from anisoscope.sim.pathtracer.plastic import LobeName


class MaterialPart(Part):
    """The plastic of the sample; roughness is what the height map does not hold.

    ``lobe`` is the distribution of slopes of the microfacets: ``beckmann``; ``ggx`` and ``student`` (γ = 3) have longer
    tails; ``two-scale`` and ``wide-base`` are mixtures of two Beckmann lobes (`anisoscope.sim.pathtracer.plastic`).
    """

    alpha_along: Annotated[float, Field(gt=0.0, lt=2.0)] = 0.06
    alpha_across: Annotated[float, Field(gt=0.0, lt=2.0)] = 0.10
    albedo: Share = 0.2
    index: Annotated[float, Field(gt=1.0, le=4.0)] = 1.5
    lobe: LobeName = "beckmann"


class CodePart(Part):
    """A code on a label next to the sample: text, centre and width in mm, and reflectances of its print.

    ``gs1`` writes an element string such as ``(10)LOT7(21)A17``. The label counts as part of the fixture's plate.
    """

    text: Annotated[str, Field(min_length=1)]
    kind: Literal["datamatrix", "code128", "qr"] = "datamatrix"
    gs1: bool = False
    x_mm: float
    y_mm: float
    width_mm: Positive
    turned_deg: float = 0.0
    white: Share = 0.75
    black: Share = 0.03


class SamplePart(Part):
    """The sample: synthetic ridges, a height map from a file, a print, a wafer, a plate, a white tile, or none.

    ``ridges`` are made from the fields below; ``height-map`` reads ``file`` and repeats it over the sample; ``print``
    is a sheet as the table ``print`` describes it, ``wafer`` an etched pattern as the table ``wafer`` does, ``plate``
    fields of ridges in several directions as ``plate`` does. With ``reflections`` light on ridges, height maps and
    plates is reflected several times, else once.
    """

    kind: Literal["ridges", "height-map", "print", "wafer", "plate", "white-tile", "none"] = "ridges"
    file: LocalPath | None = None
    size_mm: Positive = 2.4
    pitch_um: Positive = 100.0
    ridge_angle_deg: Annotated[float, Field(ge=0.0, lt=45.0)] = 10.0
    resolved_alpha: NotNegative = 0.03
    correlation_um: Positive = 8.0
    burr_coverage: Share = 0.0
    reflections: bool = True
    reflectance: Share = 0.99
    seating_tilt_deg: tuple[float, float] = (0.0, 0.0)
    material: MaterialPart = MaterialPart()
    code: CodePart | None = None
    print: PrintPart | None = None
    wafer: WaferPart | None = None
    plate: PlatePart | None = None

    @model_validator(mode="after")
    def _has_its_file(self) -> Self:
        if self.kind == "height-map" and self.file is None:
            raise ValueError("a sample of kind 'height-map' needs a file: set sample.file")
        if self.print is not None and self.kind != "print":
            raise ValueError(
                f"there is a table [sample.print], but the kind is '{self.kind}': set kind = \"print\""
            )
        if self.wafer is not None and self.kind != "wafer":
            raise ValueError(
                f"there is a table [sample.wafer], but the kind is '{self.kind}': set kind = \"wafer\""
            )
        if self.plate is not None and self.kind != "plate":
            raise ValueError(
                f"there is a table [sample.plate], but the kind is '{self.kind}': set kind = \"plate\""
            )
        if self.kind == "plate" and self.plate is None:
            raise ValueError("a sample of kind 'plate' needs a table [sample.plate] with its plan")
        if self.kind == "wafer" and self.wafer is None:
            raise ValueError(
                "a sample of kind 'wafer' needs a table [sample.wafer] with the file of what is etched"
            )
        return self


class SensorPart(Part):
    """The sensor in the terms of EMVA 1288.

    Units: electrons for wells and noise, electrons per second for the dark current, electrons per count for
    ``gain_e_per_dn``, counts for the black level. ``nonlinearity`` is the share of the signal that is missing at full
    well; it grows in proportion to the signal.

    ``gamma`` and ``auto_exposure`` make a webcam of it: counts grow as light to the power 1/gamma; the camera has
    automatic exposure that can be switched off, or that stays ``on`` whatever it says.

    ``filters`` make a colour sensor of it, a mosaic named by its first two rows; ``sensitivities`` is a file with the
    relative quantum efficiency of each kind of pixel, in place of the made-up ones.
    """

    rows: Annotated[int, Field(ge=64, le=8192)] = 1024
    cols: Annotated[int, Field(ge=64, le=8192)] = 1024
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 12
    black_level: NotNegative = 64.0
    full_well_e: Positive = 30_000.0
    gain_e_per_dn: Positive = 7.5
    read_noise_e: NotNegative = 6.0
    dark_current_e_s: NotNegative = 20.0
    prnu: Share = 0.004
    dsnu_e: NotNegative = 2.0
    hot_pixel_share: Share = 1e-5
    nonlinearity: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    gamma: Annotated[float, Field(ge=0.25, le=4.0)] = 1.0
    auto_exposure: Literal["none", "off", "on"] = "none"
    filters: Filters = "mono"
    sensitivities: NameOrFile = "synthetic"


class OpticsPart(Part):
    """Lens and light: blur, vignetting, and how far the axis is off the picture's centre.

    ``electrons`` is what one second of exposure at unit gain collects per pixel from a radiance of 1/sr; behind
    colour filters, per pixel of the strongest colour. A cold lamp is brighter by ``lamp_warmup_share`` (darker, if
    negative), and loses it over ``lamp_warmup_frames`` lit frames. ``spectrum`` is the lamp's: ``led-white`` (made
    up), a CIE illuminant such as ``d65`` or ``a``, or a file *.csv. A lamp at ``lamp_distance_mm`` shines on
    every place of ridges, height maps and prints from another direction; without it, it is far away.
    ``numerical_aperture`` (on the side of the sample) and ``wavelength_nm`` set the depth of field where there is an
    axis ``z``.
    """

    pixel_um: Positive = 4.0
    blur_um: NotNegative = 4.0
    vignetting: Share = 0.15
    axis_px: tuple[float, float] = (3.4, -2.2)
    electrons: Positive = 6.0e6
    spectrum: NameOrFile = "led-white"
    lamp_noise: Share = 0.0005
    lamp_drift_per_frame: float = 0.0
    lamp_warmup_share: Annotated[float, Field(gt=-1.0, le=1.0)] = 0.0
    lamp_warmup_frames: Positive = 50.0
    lamp_distance_mm: Positive | None = None
    stray_radiance: NotNegative = 0.0002
    lens_cap: bool = False
    numerical_aperture: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.05
    wavelength_nm: Positive = 550.0


class StagePart(Part):
    """The stage under the sample.

    ``protocol``, ``model`` and ``address`` say which device it is; "" is the usual one. ``zero_deg`` is its reading
    where the sample truly stands at 0°, ``turns`` the sense in which a growing reading truly turns the sample,
    ``backlash_deg`` the play between motor and sample. ``time_scale`` stretches the time of motions; with 0 they end at
    once, and who waits for the stage in the same process waits in virtual time.
    """

    protocol: Literal["elliptec", "zaber", "grbl", "apt", "smc100"] = "elliptec"
    model: str = ""
    address: str = ""
    zero_deg: float = 10.0
    turns: Literal["ccw", "cw"] = "ccw"
    backlash_deg: NotNegative = 0.0
    time_scale: NotNegative = 0.1
    faults: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        try:
            build(self.protocol, [Mount(RotaryAxis(), self.address)], model=self.model, faults=self.faults)
        except UsageError as problem:
            raise ValueError(str(problem)) from None
        return self


class TiltPart(Part):
    """A second axis on the stage's line that tilts the camera arm.

    ``zero_deg`` is its reading where the arm truly stands upright, ``sign`` −1 where a growing reading tilts the
    other way.
    """

    address: str = ""
    zero_deg: float = 30.0
    sign: Literal[-1, 1] = 1
    backlash_deg: NotNegative = 0.0


class LinearPart(Part):
    """A linear axis: ``z`` lifts the plate through the plane of focus, ``x`` and ``y`` shift the stage with its axis.

    ``protocol`` and ``model`` say which device it is; "" is the first linear one. Axes of a protocol are on one line.
    ``zero_mm`` is the reading at which the plate is in focus, or the axis of the stage where ``optics.axis_px`` has it;
    ``sign`` is −1 where a growing reading truly moves the other way. ``backlash_mm`` is the play.
    """

    protocol: Literal["elliptec", "zaber", "grbl", "apt", "smc100"] = "zaber"
    model: str = ""
    address: str = ""
    zero_mm: float = 10.0
    sign: Literal[-1, 1] = 1
    backlash_mm: NotNegative = 0.0


class TrayPart(Part):
    """Places of equal samples on the plate, in mm from the axis of the stage, and unevenness of the plate.

    Every one carries the markers of ``fixture`` about its middle.

    ``slope`` is by how many mm the plate rises per mm to the right and up, at sample angle 0; ``bow_mm`` by how much at
    a distance of 10 mm from the axis, growing as the square of the distance.
    """

    parts: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    slope: tuple[float, float] = (0.0, 0.0)
    bow_mm: float = 0.0

    def height_mm(self, x_mm: float, y_mm: float) -> float:
        """Height of the plate over that at its axis."""
        return self.slope[0] * x_mm + self.slope[1] * y_mm + self.bow_mm * (x_mm**2 + y_mm**2) / 100.0


class GeometryPart(Part):
    """True directions of camera and light; with a tilt axis, ``tilt_deg`` is added."""

    light_angle_deg: float = 10.0
    tilt_deg: float = 0.0


class LampPart(Part):
    """One of several lamps: its true direction, brightness, and wavelength where a wafer's differs."""

    light_angle_deg: float = 10.0
    brightness: Positive = 1.0
    wavelength_nm: Positive | None = None


class FilterPart(Part):
    """A filter of the wheel: the share of the light that it passes, and the wavelength that it leaves a wafer."""

    passes: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    wavelength_nm: Positive | None = None


class FaultsPart(Part):
    """Faults of the rig, none by default.

    A pose begins with the first lit frame at another angle. Lists give one factor per pose, the last of which holds on.

    Light: ``lamp`` are factors on its brightness; ``lamp_slope`` is the share by which it rises from the middle to the
    right and the upper edge; ``glare_radiance`` in 1/sr is light that only lit frames have, ``glare_slope`` its slope;
    ``veiling_glare`` is the share of a picture's mean light that the lens spreads over all of it;
    ``room_radiance`` is light of the room that also dark frames have, one value per frame, the last of which holds on.

    Camera: ``exposure`` and ``gain`` are factors on what it was told; with ``automatic_gain`` every pose gets the mean
    of the first; ``black_in_dark`` is how many counts dark frames lie higher than lit ones; with ``stale_pose`` the
    first frame of a pose shows the pose before; every ``repeats_every``-th frame is the buffer before, bit for bit;
    every ``torn_every``-th lit frame is torn in its lower part: rows ``zero``, ``shifted`` or ``dropped``;
    ``plateau_counts`` is where it clips below full scale; ``stuck_columns`` and ``stuck_pixels`` (row, column) always
    have ``stuck_counts``; ``mirrored`` exchanges left and right; with ``replays`` it says of the pictures of its last
    start that they are new. A response that bends is ``sensor.nonlinearity``.

    Lens: ``barrel`` is the share by which a corner of the picture moves inwards, negative for a pincushion.

    Part: it is ``seated_deg`` turned in its fixture, or ``upside_down``, which mirrors ridges and height maps across;
    from pose ``slips_at`` on, counted from 1, it stands ``slip_deg`` from its fixture.

    Markers: a blot on ``dirty_marker``, a shadow on ``shadowed_marker``, each the id of one.
    """

    lamp: tuple[NotNegative, ...] = ()
    lamp_slope: tuple[float, float] = (0.0, 0.0)
    glare_radiance: NotNegative = 0.0
    glare_slope: tuple[float, float] = (0.0, 0.0)
    veiling_glare: Share = 0.0
    room_radiance: tuple[NotNegative, ...] = ()
    exposure: tuple[Positive, ...] = ()
    gain: tuple[Positive, ...] = ()
    automatic_gain: bool = False
    black_in_dark: float = 0.0
    stale_pose: bool = False
    repeats_every: Annotated[int, Field(ge=2)] | None = None
    torn: Literal["zero", "shifted", "dropped"] | None = None
    torn_every: Annotated[int, Field(ge=1)] = 1
    plateau_counts: Annotated[int, Field(ge=1, le=65535)] | None = None
    stuck_columns: tuple[int, ...] = ()
    stuck_pixels: tuple[tuple[int, int], ...] = ()
    stuck_counts: Annotated[int, Field(ge=0, le=65535)] = 4095
    mirrored: bool = False
    replays: bool = False
    barrel: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    seated_deg: float = 0.0
    upside_down: bool = False
    slips_at: Annotated[int, Field(ge=1)] | None = None
    slip_deg: float = 0.0
    dirty_marker: int | None = None
    shadowed_marker: int | None = None

    seen: ClassVar[set[str]] = {"mirrored", "barrel", "upside_down", "dirty_marker", "shadowed_marker"}
    """The faults that a picture without noise shows."""


class BenchFile(Part):
    """A virtual rig: sample, sensor, optics, stage, fixture, and the seed of everything random.

    ``lamps`` are those of a CoolLED controller, by letter, in place of the one lamp of ``optics``; ``filters`` those of
    a wheel before them, from place 1 on.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    seed: int = 1
    sample: SamplePart = SamplePart()
    sensor: SensorPart = SensorPart()
    optics: OpticsPart = OpticsPart()
    stage: StagePart = StagePart()
    tilt: TiltPart | None = None
    x: LinearPart | None = None
    y: LinearPart | None = None
    z: LinearPart | None = None
    tray: TrayPart = TrayPart()
    geometry: GeometryPart = GeometryPart()
    fixture: Fixture | None = None
    lamps: dict[Literal["A", "B", "C", "D"], LampPart] = Field(default_factory=dict)
    filters: Annotated[tuple[FilterPart, ...], Field(max_length=max(PLACES.values()))] = ()
    faults: FaultsPart = FaultsPart()

    @model_validator(mode="after")
    def _faults_fit(self) -> Self:
        markers = {marker.id for marker in self.fixture.markers} if self.fixture is not None else set()
        for name in ("dirty_marker", "shadowed_marker"):
            number = getattr(self.faults, name)
            if number is not None and number not in markers:
                raise ValueError(f"faults.{name}: the fixture has no marker {number}")
        pixels = [*self.faults.stuck_pixels, *((0, column) for column in self.faults.stuck_columns)]
        if any(not (0 <= row < self.sensor.rows and 0 <= col < self.sensor.cols) for row, col in pixels):
            raise ValueError(
                f"faults: stuck columns and pixels lie within {self.sensor.rows} rows and {self.sensor.cols} columns"
            )
        return self

    @property
    def linear(self) -> dict[str, LinearPart]:
        """The linear axes that it has, by their tables."""
        found = {name: getattr(self, name) for name in ("x", "y", "z")}
        return {name: part for name, part in found.items() if part is not None}

    def vision(self) -> Vision:
        """The sensor's channels under the bench's lamp.

        Raises:
            RigFileError: a spectrum that the bench file names cannot be used.
        """
        try:
            illuminant = find_illuminant(self.optics.spectrum)
        except UsageError as problem:
            raise RigFileError(f"optics.spectrum: {problem}") from None
        try:
            sensitivities = find_sensitivities(self.sensor.sensitivities, self.sensor.filters)
        except UsageError as problem:
            raise RigFileError(f"sensor.sensitivities: {problem}") from None
        try:
            return Vision(illuminant, sensitivities)
        except ModelError as problem:
            raise RigFileError(f"sensor.sensitivities, optics.spectrum: {problem}") from None


def read_bench(path: Path) -> BenchFile:
    """Read a bench file; ``${here}`` in it is the folder of the file.

    Raises:
        RigFileError: the file is missing or wrong, or a print's ink or spectrum cannot be used; the message names the
            key.
    """
    found = read_toml_model(
        path, BenchFile, error=RigFileError, substitutions={"here": str(path.resolve().parent)}
    )
    if found.sample.kind == "print":
        from anisoscope.sim.bench.prints import check_print  # noqa: PLC0415 - of one kind of sample only

        try:
            check_print(found.sample.print or PrintPart(), found.vision())
        except RigFileError as problem:
            raise RigFileError(f"{path}: {problem}") from None
    return found
