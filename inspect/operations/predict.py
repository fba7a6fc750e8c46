"""Radiances and contrasts of a part: of ideal ridges, of a height map, or of a recipe."""

import hashlib
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.operations.plastic import plastic_of
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty, default_uncertainty
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign

if TYPE_CHECKING:
    from anisoscope.prediction.angular import AngularReflectance
    from anisoscope.prediction.optics_selection import Rig
    from anisoscope.prediction.predicted import Predicted
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.recipe.material_file import MaterialFile
    from anisoscope.sim.light.colour.illuminant import Illuminant

Model = Literal["auto", "geometric", "wave", "both", "printed", "corrected", "relief"]
BY_RAYS = ("printed", "corrected", "relief")
"""Models that know rays only, and look for no waves."""
CACHED = "printed-predictions"
"""Kind of entry in the cache."""
READERS = ("SurfaceTopography",)
"""What reads height maps besides the readers of this package."""


@dataclass(frozen=True)
class Method:
    """How light is followed, and how a height map is read.

    Attributes:
        model: rays or waves, "auto" as the surface needs; or a model by rays: "printed" as published, "corrected" of a
            design, "relief" of a map.
        bounces: largest number of reflections, or "all".
        light: wavelengths, for the choice of the model and for waves.
        interpolate: points per original point along each axis, for waves on smooth maps.
        steps: number of plateaus of a stepped map, for waves; they are found where it is not given.
        monte_carlo: number of draws of all inputs; None draws none.
        seed: of the draws.
        reflect: reflections of a map: of the groove fitted to it, or of paths followed on it.
        level: how a map is levelled.
        max_missing: share of missing facets above which a map is refused.
        facets: four points of a map as one facet, or as two triangles.
        roughness: that of the lobe, or of the plastic at all scales.
        pixel_um: (y, x) pixel size of a file that states none.
        role: whether a file is of the part or of the tool.
    """

    model: Model = "auto"
    bounces: int | Literal["all"] = "all"
    light: LightSpectrum = field(default_factory=LightSpectrum)
    interpolate: int = 1
    steps: int | None = None
    monte_carlo: int | None = None
    seed: int = 0
    reflect: Literal["groove", "paths"] = "groove"
    level: Literal["auto", "plane", "none"] = "auto"
    max_missing: float = 0.25
    facets: Literal["symmetric", "diagonal", "antidiagonal"] = "symmetric"
    roughness: Literal["lobe", "plastic"] = "lobe"
    pixel_um: tuple[float, float] | None = None
    role: Literal["part", "tool"] = "part"


@dataclass(frozen=True)
class Task:
    """All that a prediction of a design or of a height map is computed from.

    Attributes:
        surface: ideal ridges, a map, or its file.
        material: the plastic.
        file: the material file that states it, whose covariance counts; or None.
        angles_deg: stage angles.
        tilts_deg: tilts of camera and light.
        convention: how angles are counted.
        optics: lamp and lens.
        inputs: standard uncertainties of the inputs; None for none.
        pitch_um: of a map, where it is not to be found in it.
        method: how light is followed.
    """

    surface: "HeightMap | RidgeDesign | Path"
    material: Material
    file: "MaterialFile | None" = None
    angles_deg: tuple[float, ...] = (0.0, 90.0, 180.0)
    tilts_deg: tuple[float, ...] = (0.0,)
    convention: Convention = field(default_factory=Convention)
    optics: Optics = POINT_LIKE
    inputs: InputUncertainty | None = None
    pitch_um: float | None = None
    method: Method = Method()

    def key(self) -> dict[str, object]:
        """The task as JSON; a height map by its content and its name.

        Raises:
            HeightMapError: it cannot be read.
        """
        if isinstance(self.surface, Path):
            try:
                surface: object = [
                    self.surface.name,
                    hashlib.sha256(bounded_bytes(self.surface, MOST_PICTURE_BYTES)).hexdigest(),
                ]
            except OSError as problem:
                raise HeightMapError(
                    f"{self.surface}: cannot be read: {problem.strerror or problem}"
                ) from problem
        else:
            surface = asdict(self.surface)
        plain = replace(self, surface=RidgeDesign(100.0, 0.0), file=None)
        return asdict(plain) | {"surface": surface, "file": self.file and self.file.digest()}

    def predictions(self, on_progress: Advance = silent) -> "tuple[Predicted, ...]":
        """The prediction; of the model "both" one by rays and one by waves.

        Raises:
            HeightMapError: the map cannot be read or used.
            ModelError: a pose that sees the surface from below, or waves that cannot be had.
        """
        from anisoscope.prediction.monte_carlo import MonteCarlo
        from anisoscope.prediction.optics_selection import OpticsRequest, Rig, predict_with_optics
        from anisoscope.profiles.files.load import read_height_map
        from anisoscope.sim.light.geometry import pose_grid

        how, surface, inputs = self.method, self.surface, self.inputs
        if isinstance(surface, Path):
            surface = read_height_map(surface, pixel_um=how.pixel_um, role=how.role)
        if inputs is not None and not isinstance(surface, RidgeDesign):
            inputs = replace(inputs, ridge_angle_deg=0.0)  # a map has the ridge angle that it has
        poses = pose_grid(self.angles_deg, self.tilts_deg)
        draws = None if how.monte_carlo is None else MonteCarlo(how.monte_carlo, how.seed)
        rig = Rig(self.material, poses, self.convention, self.optics, inputs, draws, self.file)

        def by_rays(advance: Advance) -> "Predicted":
            return _by_rays(surface, rig, self.pitch_um, how, advance)

        if how.model in BY_RAYS:
            return (by_rays(on_progress),)
        # roughness of the plastic at all scales belongs to rays
        model = "geometric" if how.roughness == "plastic" and how.model == "auto" else how.model
        request = OpticsRequest(model, how.light, how.interpolate, _count(how), how.steps)  # type: ignore[arg-type]
        return predict_with_optics(surface, by_rays, rig, request, self.pitch_um, how.level, on_progress)

    def cached(self, on_progress: Advance = silent) -> "tuple[Predicted, ...]":
        """The same; what was predicted before comes from the cache on disk.

        Raises:
            HeightMapError, ModelError: as for `predictions`.
        """
        from anisoscope.base.cache import LIBRARIES, Cache
        from anisoscope.prediction.predicted import packed, unpacked

        entry = Cache().entry(CACHED, self.key(), __name__, libraries=(*LIBRARIES, *READERS))
        return entry.result(lambda: self.predictions(on_progress), packed, unpacked)


def _count(how: Method) -> int | None:
    return None if how.bounces == "all" else how.bounces


def _by_rays(
    surface: "HeightMap | RidgeDesign", rig: "Rig", pitch_um: float | None, how: Method, on_progress: Advance
) -> "Predicted":
    from anisoscope.prediction.predict import predict_design
    from anisoscope.prediction.region_prediction import predict_map

    if isinstance(surface, RidgeDesign):
        return predict_design(
            surface,
            rig.material,
            rig.poses,
            rig.convention,
            "printed" if how.model == "printed" else "corrected",
            _count(how),
            rig.inputs,
            rig.monte_carlo,
            on_progress,
            rig.optics,
            rig.file,
        )
    return predict_map(
        surface,
        rig.material,
        rig.poses,
        rig.convention,
        pitch_um,
        levelling=how.level,
        max_missing_share=how.max_missing,
        inputs=rig.inputs,
        monte_carlo=rig.monte_carlo,
        on_progress=on_progress,
        bounces=_count(how),
        optics=rig.optics,
        facets=how.facets,
        roughness=how.roughness,
        reflect=how.reflect,
        file=rig.file,
    )


def predict(
    surface: "HeightMap | RidgeDesign | Path | str",
    *,
    angles_deg: Sequence[float] = (0.0, 90.0, 180.0),
    tilts_deg: Sequence[float] = (0.0,),
    material: Material | Path | str | None = None,
    convention: Convention | None = None,
    optics: Optics | None = None,
    model: Model = "auto",
    pitch_um: float | None = None,
    inputs: InputUncertainty | None = None,
    method: Method | None = None,
) -> "Predicted":
    """Radiances and contrasts of a height map, of a design or of a recipe's part, as ``anisoscope predict``.

    Light is followed from facet to wall and back until nothing is left. A file that was predicted before comes from the
    cache.

    Args:
        surface: measured heights or their file, ideal ridges, or the file of a recipe (``*.toml``), which decides all
            but the light angle.
        angles_deg: stage angles.
        tilts_deg: tilts of camera and light.
        material: roughness, albedo, index; or a material file. That of the command line where it is not given.
        convention: how angles are counted, and the light angle (10°).
        optics: lamp and lens; both points far away where it is not given.
        model: rays or waves; "auto" takes what the surface needs.
        pitch_um: of a map, where it is not to be found in the map.
        inputs: standard uncertainties of the inputs; where they are not given, those of a recipe that states none: the
            lobe and the crests of a design are unmeasured.
        method: how light is followed and a map is read; ``model`` is put in it.

    Raises:
        UsageError: the surface is none of these, or a recipe is given more than the light angle.
        HeightMapError: the map cannot be used: too much is missing, or too coarse for waves.
        RecipeError: recipe or material file cannot be read.
        ModelError: a pose that sees the surface from below, or a number outside its range.
    """
    from anisoscope.profiles.heightmap import HeightMap

    if not isinstance(surface, HeightMap | RidgeDesign | Path | str):
        raise UsageError(
            "predict takes a HeightMap or a RidgeDesign, or the file of a map or a recipe, not "
            f"{type(surface).__name__}"
        )
    subject = Path(surface) if isinstance(surface, Path | str) else surface
    counted = convention or Convention()
    if isinstance(subject, Path) and subject.suffix.lower() == ".toml":
        if (material, optics, pitch_um, inputs, method) != (None,) * 5 or model != "auto":
            raise UsageError(f"{subject}: a recipe decides all but the light angle: leave the rest out")
        return predict_recipe(subject, counted.light_angle_deg)
    plastic, file = plastic_of(material)
    task = Task(
        subject,
        plastic,
        file,
        tuple(angles_deg),
        tuple(tilts_deg),
        counted,
        optics or POINT_LIKE,
        inputs or default_uncertainty(plastic, calibrated=file is not None),
        pitch_um,
        replace(method or Method(), model=model),
    )
    return (task.cached if isinstance(subject, Path) else task.predictions)()[0]


def predict_recipe(path: Path, light_angle_deg: float) -> "Predicted":
    """What inspections by a recipe expect, from the cache where it was predicted before.

    Args:
        path: the recipe.
        light_angle_deg: between light and camera of the rig.

    Raises:
        UsageError: a recipe of another kind than of surfaces.
        RecipeError, HeightMapError: it or its map cannot be read or used.
    """
    from anisoscope.operations.stated import surface_kind_of
    from anisoscope.prediction.cache import cached_expectation
    from anisoscope.prediction.expectation import predicted

    kind = surface_kind_of(path)
    return predicted(cached_expectation(kind.read_recipe(path), light_angle_deg, kind.optics))


ANGULAR_COLUMNS = ("v_x", "v_y", "inclination_deg", "azimuth_deg", "wavelength_nm", "brdf_per_sr")


def write_angular_table(found: "AngularReflectance", path: Path) -> None:
    """Write the BRDF over all directions as CSV.

    Raises:
        RecordError: the file cannot be written.
    """
    from anisoscope.base.atomic_write import write_text
    from anisoscope.base.csv_style import csv_text, number_text

    rows = [[number_text(f"{value:.6g}") for value in row] for row in found.rows()]
    write_text(path, csv_text([list(ANGULAR_COLUMNS), *rows], file=True))


def write_angular_picture(found: "AngularReflectance", lamp: "Illuminant | None", path: Path) -> None:
    """Draw the BRDF with its axes: one wavelength with a bar, several as panels, under a lamp one panel in colour.

    Raises:
        RecordError: the file cannot be written.
    """
    import numpy as np

    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.report.figures import new_figure

    reach = found.task.reach
    extent = (-reach, reach, -reach, reach)
    panels = 1 if lamp is not None else len(found.brdf)
    with new_figure(4.6 * panels, 4.2) as (figure, axes):
        axes.remove()
        for panel, number in zip(figure.subplots(1, panels, squeeze=False)[0], range(panels), strict=True):
            if lamp is not None:
                panel.imshow(found.srgb(lamp), extent=extent)
                panel.set_title("colour, scaled to its brightest", fontsize=9)
            else:
                one = found.brdf[number]
                top = max(float(np.nanquantile(one, 0.997)), 1e-12)
                shown = panel.imshow(one, origin="lower", extent=extent, cmap="inferno", vmin=0.0, vmax=top)
                figure.colorbar(shown, ax=panel, label="BRDF [1/sr]", shrink=0.85)
                panel.set_title(f"{found.task.wavelengths_nm[number]:g} nm", fontsize=9)
            panel.set_xlabel("v_x [1]")
            panel.set_ylabel("v_y [1]")
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_bytes(path, stream.getvalue())
