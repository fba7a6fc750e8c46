"""A predictor of etched wafers: a tile of level steps that repeats, polished like a mirror, by its diffraction orders.

The tile is the one that was etched, not an average over random ones, so that what a finite tile shows beyond the
average is predicted too. What is reflected does not depend on the angle: the reflectance of metals changes by less than
1 % up to 30° from the normal, that of silicon by less than 2 %, and contrasts do not know it at all.
"""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, RecipeError
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.prediction.recipe_models import line_spectrum
from anisoscope.prediction.wave import discs_of
from anisoscope.profiles.etching import Etched
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.wave.orders import REACH, Bands, Orders, WidthOrders

WHOLE = 1e-3
"""How far the side of a tile may be off the pitch of the recipe, relative."""


@dataclass(frozen=True)
class WaferLight:
    """Lamp and lens.

    Attributes:
        wavelength_nm: middle of the spectrum.
        bandwidth_nm: full width at half of its height.
        lamp_half_angle_deg: of the cone of light that falls in.
        aperture_half_angle_deg: of the cone that the lens collects.
    """

    wavelength_nm: float
    bandwidth_nm: float
    lamp_half_angle_deg: float
    aperture_half_angle_deg: float

    @property
    def spectrum(self) -> LightSpectrum:
        """Spectral lines that represent the lamp."""
        return line_spectrum(self.wavelength_nm, self.bandwidth_nm)

    @property
    def optics(self) -> Optics:
        """Sizes of lamp and lens."""
        return Optics(self.lamp_half_angle_deg, self.aperture_half_angle_deg)


class NearWidths(Protocol):
    """A wafer at a bias of its widths, and with waves of its edges, in nm."""

    def __call__(self, wider_nm: float, edges_nm: complex = 0.0) -> "EtchedPredictor":
        """The predictor."""
        ...


@dataclass(frozen=True, eq=False)
class EtchedPredictor:
    """Predicts radiances of a wafer; the signature of every predictor.

    Attributes:
        tile: what is etched.
        light: lamp and lens.
        reflectance: of the coating, 0 to 1.
        orders: of the tile; at any width near its own, where `near_widths` made the predictor.
        bands: spectra of the tile's pieces, for other widths.
        reach: of the orders, in cycles per µm.
    """

    tile: Etched
    light: WaferLight
    reflectance: float
    orders: Orders | WidthOrders
    bands: dict[str, Bands]
    reach: float

    @classmethod
    def of(cls, tile: Etched, light: WaferLight, reflectance: float = 1.0, reach: float = REACH) -> Self:
        """Of a tile; ``reach`` bounds the frequencies that any direction needs."""
        bands: dict[str, Bands] = {}
        return cls(tile, light, reflectance, Orders.of(tile, reach, bands), bands, reach)

    def with_depths(self, deeper_nm: float) -> Self:
        """The same wafer, every pass deeper: the areas of the levels stay."""
        return replace(self, tile=self.tile.over_etched(1e-3 * deeper_nm))

    def with_widths(self, wider_nm: float) -> Self:
        """The same wafer, every etched feature wider."""
        tile = self.tile.widened(1e-3 * wider_nm)
        return replace(self, tile=tile, orders=Orders.of(tile, self.reach, self.bands))

    def with_pattern(self, tile: Etched) -> Self:
        """The same wafer with another pattern."""
        bands: dict[str, Bands] = {}
        return replace(self, tile=tile, orders=Orders.of(tile, self.reach, bands), bands=bands)

    def near_widths(self, step_nm: float) -> NearWidths:
        """The same wafer at any bias of its widths in nm, quick: by parabolas through widths up to a step away.

        Within the step the radiances are right to 1e-4 where edges move by less than 0.01 of a period, at twice the
        step to 1e-3. A second number, complex and in nm too, is the widening that stands for the waves of the edges
        (`anisoscope.sim.light.wave.choice.edge_widening_um`).
        """
        tile, reach = self.tile, self.reach
        series = WidthOrders.of(
            lambda share: Orders.of(tile.widened(1e-3 * step_nm * share), reach, self.bands)
        )

        def near(wider_nm: float, edges_nm: complex = 0.0) -> EtchedPredictor:
            return replace(self, orders=series.at(wider_nm / step_nm, edges_nm / step_nm))

        return near

    def under(self, light: WaferLight) -> Self:
        """The same wafer in another light."""
        return replace(self, light=light)

    def __call__(self, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        """(P,) radiances in 1/sr for (P, 3) unit vectors; of the material its albedo alone counts, the scattered share.

        Raises:
            ModelError: light or camera at or below the horizon, or a direction that the tile is not sampled for.
        """
        levels, lines, discs = np.array(self.tile.levels_um), self.light.spectrum, discs_of(self.light.optics)
        wavelengths = np.array(lines.wavelengths_um)
        weights = np.array(lines.weights) / wavelengths**2
        densities = self.orders.seen(levels, to_light, to_camera, wavelengths, discs)
        half = 0.5 * (to_light + to_camera)
        # `radiance_scale` at a wavelength of 1
        scale = (np.sum(half**2, axis=1) / half[:, 2]) ** 2 / to_camera[:, 2]
        mirrored, diffuse = scale * (densities @ weights), material.albedo / np.pi * to_light[:, 2]
        return np.asarray(self.reflectance * ((1.0 - material.albedo) * mirrored + diffuse))


def tile_of(surface: HeightMap, pitch_um: float, name: str) -> Etched:
    """The tile of a recipe's wafer.

    Args:
        surface: its height map.
        pitch_um: of the recipe.
        name: of the file, for messages.

    Raises:
        HeightMapError: it is no surface of level steps.
        RecipeError: its sides are not the pitch.
    """
    high, wide = surface.extent_um
    if max(abs(high / pitch_um - 1.0), abs(wide / pitch_um - 1.0)) > WHOLE:
        raise RecipeError(
            f"surface.pitch_um: {name} is {wide:g} × {high:g} µm, the pitch {pitch_um:g} µm: of a wafer the map "
            "must be the square tile that repeats on it, and the pitch its side"
        )
    try:
        return Etched.of(surface)
    except HeightMapError as problem:
        raise HeightMapError(f"{name}: {problem}") from None
