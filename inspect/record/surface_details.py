"""The details of a part whose contrasts are judged: a surface that reflects, ridged or etched."""

from anisoscope.record.details import Details
from anisoscope.record.schema import (
    AngleRecord,
    AreaRecord,
    ComparisonRecord,
    ContrastRecord,
    FormRecord,
    GoldenRecord,
    MapPlaceRecord,
    ReadingRecord,
    Record,
    RegionRecord,
    ShapeRecord,
    TiltContrastRecord,
)

FACET_ANGLE = "facet angle"
CONTRAST_NAMES = {"log_ratio": "ln", "difference": "difference", "michelson": "Michelson"}


class SurfaceDetails(Details):
    """Contrasts of the poses with their verdicts, the contrast map, and what explains them."""

    contrasts: tuple[ContrastRecord, ...] = ()
    between_tilts: tuple[TiltContrastRecord, ...] = ()
    area: AreaRecord | None = None
    form: FormRecord | None = None
    regions: tuple[RegionRecord, ...] = ()
    comparisons: tuple[ComparisonRecord, ...] = ()
    reading: str | None = None
    readings: tuple[ReadingRecord, ...] = ()
    shape: ShapeRecord | None = None
    golden: GoldenRecord | None = None
    map_place: MapPlaceRecord | None = None
    angles: AngleRecord | None = None
    angles_lacking: str | None = None

    def numbers(self) -> dict[str, float]:
        """The contrasts, and the lean of the facets in degrees.

        A contrast is called by kind, stage angles and tilt: ``ln 0-90``, ``ln 0-90 @10``, ``difference 90-180``.
        """
        found: dict[str, float] = {}
        for contrast in self.contrasts:
            label = label_of(contrast)
            found |= {
                label: contrast.measured,
                f"u {label}": contrast.u,
                f"deviation {label}": contrast.measured - contrast.predicted,
            }
            if contrast.tolerance is not None:
                found[f"tolerance {label}"] = contrast.tolerance
        if (angles := self.angles) is not None:
            found |= {
                FACET_ANGLE: angles.mean_deg,
                f"u {FACET_ANGLE}": angles.u_mean_deg,
                f"{FACET_ANGLE} spread": angles.spread_deg,
            }
            if angles.worst is not None:
                found[f"{FACET_ANGLE} of the worst ridge"] = angles.worst.angle_deg
        return found

    @property
    def area_share(self) -> float | None:
        """The share of the contrast map that deviates."""
        return None if self.area is None else self.area.share

    @property
    def near_limit(self) -> bool:
        """Whether a contrast or the area is too close to its limit to decide."""
        judged = (*self.contrasts, *(() if self.area is None else (self.area,)))
        return any(one.verdict == "INCONCLUSIVE" for one in judged)

    def compared(self) -> dict[str, float]:
        """The contrasts."""
        return {label_of(contrast): contrast.measured for contrast in self.contrasts}


def label_of(contrast: ContrastRecord) -> str:
    """The label of a contrast, such as ``ln 0-90 @10``."""
    return contrast_label(contrast.kind, contrast.from_deg, contrast.to_deg, contrast.tilt_deg)


def contrast_label(kind: str, from_deg: float, to_deg: float, tilt_deg: float) -> str:
    """The label of a contrast, such as ``ln 0-90 @10``; without tilt the last part is left out."""
    tilt = "" if tilt_deg == 0.0 else f" @{tilt_deg:g}"
    return f"{CONTRAST_NAMES.get(kind, kind)} {from_deg:g}-{to_deg:g}{tilt}"


def surface_of(record: Record) -> SurfaceDetails:
    """The details of a record of a surface; empty ones of a record of anything else."""
    return record.details if isinstance(record.details, SurfaceDetails) else SurfaceDetails()
