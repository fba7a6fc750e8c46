"""What reflects: the surface of `bsdf export`, from the options that name it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.options import parse_numbers

if TYPE_CHECKING:
    from anisoscope.base.arrays import FloatArray
    from anisoscope.base.progress import Advance
    from anisoscope.bsdf.reflectance import Reflectance
    from anisoscope.bsdf.rgl import Resolution
    from anisoscope.parameters.material import Material
    from anisoscope.sim.design.designfile import DesignFile
    from anisoscope.sim.design.models import AnyModel

SOURCE = Group(
    "Surface", help="One of --ridge-angle, --ink, --design, --height-map and --from-file.", sort_key=10
)
NodesOption = Annotated[
    str | None,
    Parameter(help="RGL: inclinations and azimuths of the light, and side of the square: 24,37,48."),
]
DOT_UM = 112.0
"""Side of the dots of a design, which gives its mirror-like share a width."""


@dataclass(frozen=True)
class PlasticOptions:
    """The plastic of ridges and height maps."""

    material: Annotated[
        Path | None, Parameter(help="Plastic: file of calibrate material, in place of the next four.")
    ] = None
    alpha_along: Annotated[float, Parameter(help="Plastic: Beckmann roughness along ridges.")] = 0.06
    alpha_across: Annotated[float, Parameter(help="Plastic: Beckmann roughness across ridges.")] = 0.10
    albedo: Annotated[float, Parameter(help="Plastic: diffuse albedo.")] = 0.2
    index: Annotated[float, Parameter(help="Plastic: refractive index.")] = 1.5

    def plastic(self) -> "Material":
        """The plastic."""
        from anisoscope.parameters.material import Material
        from anisoscope.recipe.material_file import read_material_file

        if self.material is not None:
            return read_material_file(self.material).material.material()
        return Material(self.alpha_along, self.alpha_across, self.albedo, self.index)


@Parameter(name="*", group=SOURCE)
@dataclass(frozen=True)
class SourceOptions(PlasticOptions):
    """What reflects."""

    ridge_angle: Annotated[
        float | None, Parameter(help="Ridges along y: ridge angle in degrees; 0 is a flat surface.")
    ] = None
    ink: Annotated[str | None, Parameter(help="Structural-colour ink: file *.toml, or a name.")] = None
    design: Annotated[Path | None, Parameter(help="Etched steps: file *.toml of anisoscope design.")] = None
    height_map: Annotated[Path | None, Parameter(help="Height map, x as the reflectance's.")] = None
    from_file: Annotated[
        Path | None,
        Parameter(
            help="File of another format (RGL, MERL, Klems, tensor tree, Zemax), or a table *.csv of bsdf import."
        ),
    ] = None
    pitch: Annotated[
        float | None, Parameter(help="Ridges, height map: pitch in µm; 100, and found in a map.")
    ] = None
    height_loss: Annotated[float, Parameter(help="Ridges: share of the height that is missing.")] = 0.0
    bounces: Annotated[
        int, Parameter(help="Ridges: reflections between facets; 2 takes thirty times as long.")
    ] = 1
    optics: Annotated[
        Literal["rays", "waves"],
        Parameter(help="Height map: rays on plastic, or waves on a mirror, for steps and depths below a µm."),
    ] = "rays"
    pixel: Annotated[
        str | None, Parameter(help="Height map: pixel size in µm where it states none, SIZE or Y,X.")
    ] = None
    lamp_half_angle: Annotated[
        float, Parameter(help="Height map by waves: half of the angle that the lamp subtends, degrees.")
    ] = 0.9

    def reflectance(self, on_progress: "Advance") -> "Reflectance":
        """The surface.

        Raises:
            UsageError: none or several surfaces, or a file that cannot be used.
            HeightMapError, ModelError, ConfigError: the map or the design cannot be used.
        """
        given: dict[str, tuple[object, Callable[[], Reflectance]]] = {
            "--ridge-angle": (self.ridge_angle, self._ridges),
            "--ink": (self.ink, self._ink),
            "--design": (self.design, self._design),
            "--height-map": (self.height_map, lambda: self._heights(on_progress)),
            "--from-file": (self.from_file, self._file),
        }
        named = [make for value, make in given.values() if value is not None]
        if len(named) != 1:
            raise UsageError(f"say what reflects: one of {', '.join(given)}")
        return named[0]()

    def _ridges(self) -> "Reflectance":
        from anisoscope.bsdf.models import of_ridges
        from anisoscope.parameters.ridges import RidgeDesign

        assert self.ridge_angle is not None
        if self.bounces < 1:
            raise UsageError(f"--bounces must be 1 or more, not {self.bounces}")
        pitch = 100.0 if self.pitch is None else self.pitch
        design = RidgeDesign(pitch, self.ridge_angle, height_loss=self.height_loss)
        name = "flat plastic" if self.ridge_angle == 0.0 else f"ridges of {self.ridge_angle:g}°"
        return of_ridges(design, self.plastic(), self.bounces, name, neglected=True)

    def _ink(self) -> "Reflectance":
        from anisoscope.bsdf.models import of_ink
        from anisoscope.sim.materials.inks import find_ink

        assert self.ink is not None
        return of_ink(find_ink(self.ink))

    def _design(self) -> "Reflectance":
        from anisoscope.sim.design.designfile import read_design

        assert self.design is not None
        return design_reflectance(read_design(self.design))

    def _file(self) -> "Reflectance":
        from anisoscope.bsdf.formats import read_reflectance

        assert self.from_file is not None
        if self.from_file.suffix.lower() == ".csv":
            from anisoscope.bsdf.directions_table import interpolated, read_mapped

            return interpolated(read_mapped(self.from_file, {}), self.from_file.stem)
        return read_reflectance(self.from_file)

    def _heights(self, on_progress: "Advance") -> "Reflectance":
        from anisoscope.bsdf.models import of_heights, of_heights_by_waves
        from anisoscope.cli.profile.profile import parse_pixel
        from anisoscope.prediction.height_map_uncertainty import best_band
        from anisoscope.prediction.relief_preparation import prepare_relief
        from anisoscope.profiles.files.load import read_height_map
        from anisoscope.sim.light.wave.choice import structure_of
        from anisoscope.sim.light.wave.surface import WaveSurface

        assert self.height_map is not None
        surface = read_height_map(self.height_map, pixel_um=parse_pixel(self.pixel))
        if self.optics == "waves":
            heights = WaveSurface.of(surface)
            return of_heights_by_waves(
                replace(heights, cells=structure_of(heights, 0.55).stepped),
                self.lamp_half_angle,
                self.height_map.stem,
                on_progress=on_progress,
            )
        relief, _ = prepare_relief(surface, self.pitch)
        return of_heights(best_band(relief), self.plastic(), self.height_map.stem)


def resolution_of(nodes: str | None) -> "Resolution | None":
    """The resolution of an RGL file; None for the usual one.

    Raises:
        UsageError: something else than three whole numbers, or too few nodes.
    """
    from anisoscope.bsdf.rgl import Resolution

    if nodes is None:
        return None
    numbers = parse_numbers(nodes, "--nodes", "24,37,48")
    if len(numbers) != 3 or any(n != int(n) for n in numbers):
        raise UsageError(f"--nodes takes three whole numbers, such as 24,37,48, not {nodes!r}")
    theta, phi, square = (int(n) for n in numbers)
    return Resolution(theta, phi, square)


def design_reflectance(design: "DesignFile", dot_um: float = DOT_UM) -> "Reflectance":
    """Reflectance of a design of etched steps, in dots of a size."""
    from anisoscope.bsdf.models import of_design
    from anisoscope.sim.design.models import model_density

    def density(frequency: "FloatArray", nm: float, tau: float) -> "FloatArray":
        coherence = design.coherence_um * nm / design.wavelength_nm
        return model_density(design.model, frequency, frequency, coherence, dot_um, tau)

    levels = design.depths.levels_um if design.passes_nm else (0.0,)
    return of_design(design.name, density, levels, (dot_um, _widest_um(design.model), design.coherence_um))


def _widest_um(model: "AnyModel") -> float:
    """The widest step, or block of steps, whose ripples the spectrum has."""
    from anisoscope.sim.design.models import AntiMirrorModel, LobeModel, MixtureModel

    if isinstance(model, MixtureModel):
        return max(_widest_um(one) for one in model.models)
    if isinstance(model, LobeModel):
        return max(*model.widths_x_um, *model.widths_y_um)
    if isinstance(model, AntiMirrorModel):
        return max(many * wide for many, wide in zip(model.arrangement, model.widths_um, strict=True))
    return 1.0
