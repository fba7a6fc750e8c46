"""Record models of a print: colours, quantities, lobe, map, and the golden prints."""

from typing import Any

from pydantic import BaseModel, ConfigDict

from anisoscope.base.arrays import FloatArray
from anisoscope.record.details import Details
from anisoscope.record.schema import Record
from anisoscope.record.verdict import Verdict

Triple = tuple[float, float, float]
RELATIVE = frozenset({"alpha x", "alpha y", "gain"})
"""Quantities whose deviation, uncertainty and limit are shares of what they should be."""
LENGTHS = frozenset({"chromaticity", "tilt", "delta_e", "curl"})
"""Quantities that are never negative: how far apart, whichever way."""
MOST_SPOTS = 12
"""Places of the map that a record lists, the largest first."""


def triple(values: FloatArray) -> Triple:
    """Three numbers as JSON holds them."""
    red, green, blue = (float(value) for value in values)
    return red, green, blue


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class ColourRecord(_Part):
    """One pose of a print: red, green and blue in 1/sr, XYZ with Y = 1 for a perfect white, and CIEDE2000.

    ``predicted`` is what the recipe predicts; ``wanted`` what it predicts for a print that leans as this one does, with
    which ``measured`` is compared. ``u`` are relative standard uncertainties of measured over wanted.
    """

    stage_deg: float
    tilt_deg: float
    measured: Triple
    predicted: Triple
    wanted: Triple
    u: Triple
    xyz: Triple
    xyz_predicted: Triple
    delta_e: float
    u_delta_e: float


class QuantityRecord(_Part):
    """A quantity that is judged.

    ``deviation``, ``u``, ``limit`` and ``guard`` have one unit: relative for roughness and level, else ``unit``.
    """

    name: str
    title: str
    unit: str
    value: float
    nominal: float
    deviation: float
    u: float
    limit: float
    guard: float
    conformance_probability: float
    verdict: Verdict


class SpotRecord(_Part):
    """Adjoining cells that deviate: middle and extents in mm, and the largest CIEDE2000 among them.

    ``area_share`` is the share of the area that the pixels off by more than the limit cover; without pictures, of the
    cells.
    """

    x: float
    y: float
    width: float
    length: float
    area_share: float
    cells: int
    delta_e: float


class PrintMapRecord(_Part):
    """The map of local colour differences.

    ``noise`` is the CIEDE2000 that noise alone makes; ``cell_limit`` took the place of ``cell_delta_e`` where the cells
    of the print scatter much. ``curl_deg`` holds the change of the tilt toward x and toward y
    (rows) across the region along x and along y (columns). ``spots`` are the largest, `MOST_SPOTS` at most. ``learnt``
    if the limit is that of golden prints, ``p_value`` by them.
    """

    cell_mm: float
    rows: int
    cols: int
    cell_delta_e: float
    noise: float
    share: float
    u: float
    max_share: float
    verdict: Verdict
    curl_deg: tuple[tuple[float, float], tuple[float, float]]
    u_curl_deg: float
    spots: tuple[SpotRecord, ...] = ()
    learnt: bool = False
    p_value: float | None = None
    cell_limit: float | None = None

    @property
    def threshold(self) -> float:
        """CIEDE2000 beyond which a cell deviates."""
        return self.cell_delta_e if self.cell_limit is None else self.cell_limit


class LobeRecord(_Part):
    """The fitted lobe.

    ``form`` is 0 for the distribution of normals of the recipe, 1 for the other one of GGX and Beckmann, relative to
    ``print.lobe`` of the recipe. ``tilt_deg`` leans toward x and y. ``levels`` are relative, of red, green and blue.
    """

    alpha: float
    u_alpha: float
    form: float
    u_form: float
    tilt_deg: tuple[float, float]
    levels: Triple
    chi2: float
    dof: int


class GoldenFitRecord(_Part):
    """A fitted parameter of this print and of the golden prints, with their mean and standard deviation.

    All are taken linearly about the print that the recipe predicts, which has 0.
    """

    name: str
    title: str
    unit: str
    measured: float
    mean: float
    s: float
    golden: tuple[float, ...]


class GoldenColourRecord(_Part):
    """Colour of one pose compared with the golden prints, all corrected for their lean.

    ``delta_e`` is the CIEDE2000 from their mean, ``spread`` the root mean square of theirs, ``t2`` T² of
    the three channels; ``p_value`` is adjusted over all tests (Holm).
    """

    stage_deg: float
    tilt_deg: float
    delta_e: float
    spread: float
    t2: float
    p_value: float


class GoldenPrintsRecord(_Part):
    """The golden prints that decided what deviates; ``t2`` and ``p_value`` are of all fitted parameters together.

    ``lot`` names the lot where they are its other prints, of unknown quality.
    """

    parts: int
    lot: str | None = None
    t2: float
    p_value: float
    fitted: tuple[GoldenFitRecord, ...]
    colours: tuple[GoldenColourRecord, ...]

    @property
    def words(self) -> str:
        """What this print was compared with, in words."""
        return "golden prints" if self.lot is None else f"other prints of lot {self.lot}"


class PrintDetails(Details):
    """A print: what it was compared with, the colours of its poses, the lobe, the map and what was judged.

    ``to_xyz`` takes π times the channels to XYZ; ``matrix_residual`` is the CIEDE2000 that it leaves on the spectra of
    a good print, ``exposure`` the factor on XYZ before colours are compared against ``white``. ``lobe`` is None where
    nothing is printed, so that there is none.
    """

    ink: str
    lamp: str
    sensitivities: str
    filters: str
    to_xyz: tuple[Triple, Triple, Triple]
    white: Triple
    exposure: float
    matrix_residual: float
    matrix_residual_changed: float
    colours: tuple[ColourRecord, ...]
    quantities: tuple[QuantityRecord, ...]
    lobe: LobeRecord | None
    map: PrintMapRecord | None
    not_judged: tuple[str, ...] = ()
    golden: GoldenPrintsRecord | None = None

    def numbers(self) -> dict[str, float]:
        """The quantities, such as ``print alpha x``, and the share of the area that deviates."""
        numbers: dict[str, float] = {}
        for one in self.quantities:
            # deviation, u and limit of a relative quantity are converted to the unit of its value
            label, unit = f"print {one.name}", one.nominal if one.name in RELATIVE else 1.0
            numbers |= {
                label: one.value,
                f"u {label}": unit * one.u,
                f"deviation {label}": unit * one.deviation,
            }
            numbers[f"tolerance {label}"] = unit * one.limit
        return numbers if self.map is None else numbers | {"area share": self.map.share}

    @property
    def near_limit(self) -> bool:
        """Whether a quantity or the area is too close to its limit to decide."""
        judged = (*self.quantities, *(() if self.map is None else (self.map,)))
        return any(one.verdict == "INCONCLUSIVE" for one in judged)

    @classmethod
    def of_schema_1(cls, record: dict[str, Any]) -> dict[str, Any] | None:
        """Details from the key ``print`` of a record of schema 1."""
        found: dict[str, Any] | None = record.pop("print", None)
        return found


def print_of(record: Record) -> PrintDetails | None:
    """The details of the record of a print; None of an inspection that could not be judged, or of anything else."""
    return record.details if isinstance(record.details, PrintDetails) else None
