"""Uncertainty of a prediction from its height map: noise, pixel size, and the number of ridges."""

from dataclasses import replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.prediction.ridge_edges import RidgeEdges
from anisoscope.prediction.sensitivity import DARK, Contribution, Model, Shape, Surface
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

SAMPLED_ROWS = 160
REALISATIONS = 8
MIN_RIDGES = 4


def best_band(relief: Relief) -> Relief:
    """Band with as many rows as the sensitivities need, where the fewest heights are missing."""
    height = relief.surface.height_um
    count = min(height.shape[0], SAMPLED_ROWS)
    known = np.concatenate([[0], np.cumsum(np.isfinite(height).sum(axis=1))])
    start = int(np.argmax(known[count:] - known[:-count]))
    band = relief.surface.with_height(height[start : start + count])
    return replace(relief, surface=band, max_missing_share=1.0)


def relief_model(
    relief: Relief,
    optics: Optics = POINT_LIKE,
    on_progress: Advance = silent,
    edges: RidgeEdges | None = None,
) -> Model:
    """Predictor of one relief under given lamp and lens; with what its points miss of ``edges``."""

    def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        found = relief_radiance(relief, to_light, to_camera, material, on_progress)
        return found if edges is None else np.asarray(found + edges.light(to_light, to_camera, material))

    return through(predict, optics)


def relief_surface(relief: Relief, optics: Optics = POINT_LIKE) -> Surface:
    """Predictor of a relief with a scale factor on its heights."""

    def shaped(shape: Shape) -> Model:
        if shape.height_factor == 1.0:
            return relief_model(relief, optics)
        scaled = relief.surface.with_height(relief.surface.height_um * shape.height_factor)
        return relief_model(replace(relief, surface=scaled, max_missing_share=1.0), optics)

    return shaped


def map_contributions(
    relief: Relief,
    directions: tuple[FloatArray, FloatArray],
    material: Material,
    radiance: FloatArray,
    inputs: InputUncertainty | None,
    on_progress: Advance = silent,
    indirect: FloatArray | None = None,
    edges: RidgeEdges | None = None,
) -> tuple[Contribution, ...]:
    """Contributions of the map itself, except those of its scale; none without ``inputs``.

    Args:
        relief: the whole map, prepared.
        directions: (P, 3) unit vectors to the light and to the camera.
        material: the plastic.
        radiance: (P,) nominal radiances of the whole map in 1/sr.
        inputs: standard uncertainties.
        on_progress: called at every step.
        indirect: (P,) of the radiances what reflects twice and more; None for direct light alone.
        edges: profile of walls and crests that was fitted to the map.
    """
    if inputs is None:
        return ()
    steps = REALISATIONS if inputs.height_noise_um > 0.0 else 0
    found = [Contribution("height map, overall", inputs.height_map_share * radiance, "independent")]
    if edges is not None:
        found += edge_contributions(edges, directions, material, radiance, indirect)
    elif relief.pitch_um is not None:
        found.append(pixel_bias(relief.surface.pixel_x_um, relief.pitch_um, radiance, indirect))
    if steps:
        rng = np.random.default_rng(0)  # fixed seed: the same map always has the same uncertainty
        found += height_noise(
            relief, directions, material, radiance, inputs.height_noise_um, rng, on_progress
        )
    scatter = ridge_scatter(relief, directions, material, inputs.ridges_seen, on_progress)
    return (*found, *(() if scatter is None else (scatter,)))


EDGES = "walls and crests between the points"
OF_FITTED, OF_FITTED_INDIRECT = 0.003, 0.03
"""Of the radiance and of its indirect part: what a fitted profile leaves, in each pose (docs/wall_fit.py)."""


def edge_contributions(
    edges: RidgeEdges,
    directions: tuple[FloatArray, FloatArray],
    material: Material,
    radiance: FloatArray,
    indirect: FloatArray | None = None,
) -> list[Contribution]:
    """Contributions of the profile of walls and crests, as far as the points of the map leave it open.

    Place, draft and radius of the fitted profile move by their principal standard deviations, each for all poses
    together; what a fit leaves where they are known counts in each pose.

    Args:
        edges: the fitted profile.
        directions: (P, 3) unit vectors to the light and to the camera.
        material: the plastic, with the roughness that the map does not resolve.
        radiance: (P,) all light in 1/sr.
        indirect: (P,) of it what reflects twice and more; None for direct light alone.
    """
    within = np.zeros_like(radiance) if indirect is None else indirect
    left = np.hypot(OF_FITTED * radiance, OF_FITTED_INDIRECT * within)
    shifts = edges.uncertainty(*directions, material, indirect)
    found = [
        Contribution(f"{EDGES}, {number + 1}", shift) for number, shift in enumerate(shifts) if np.any(shift)
    ]
    return [*found, Contribution(f"{EDGES}, fit", left, "independent")]


OF_PIXELS = 7.5
"""Error of the indirect part on a height map, over its size and pixel/pitch: what a wall of one pixel does not show."""


def pixel_error(
    pixel_um: float, pitch_um: float, radiance: FloatArray, indirect: FloatArray | None = None
) -> FloatArray:
    """(P,) standard uncertainty in 1/sr from walls narrower than a pixel.

    Of the light of the facets up to one pixel per pitch is lost, rectangular. A wall of one pixel reflects other light
    between facet and wall than that of the part: 7.5 pixel/pitch of the indirect part, which is 4 % of the radiance at
    180° and 2.5 % at 90° for ridges of 10° of smooth dark plastic (α 0.08, ρ 0.1) under pixels of 1/50 of the pitch.

    Args:
        pixel_um: size across the ridges.
        pitch_um: of the ridges.
        radiance: (P,) all light in 1/sr.
        indirect: (P,) of it what reflects twice and more; None for direct light alone.
    """
    share, within = pixel_um / pitch_um, np.zeros_like(radiance) if indirect is None else indirect
    return np.asarray(share * np.hypot((radiance - within) / np.sqrt(3.0), OF_PIXELS * within))


def pixel_bias(
    pixel_um: float, pitch_um: float, radiance: FloatArray, indirect: FloatArray | None = None
) -> Contribution:
    """Contribution of walls narrower than a pixel (`pixel_error`)."""
    error = pixel_error(pixel_um, pitch_um, radiance, indirect)
    return Contribution("pixel size against the walls", error, "independent", rectangular=True)


def height_noise(
    relief: Relief,
    directions: tuple[FloatArray, FloatArray],
    material: Material,
    radiance: FloatArray,
    noise_um: float,
    rng: np.random.Generator,
    on_progress: Advance = silent,
    realisations: int = REALISATIONS,
) -> list[Contribution]:
    """Contributions of height noise: the mean shift of the radiance, and the scatter about it.

    Derivatives for a million points are infeasible, and to first order the errors of independent points average
    out; the remaining effect is of second order, because noise adds slopes and so widens the lobe. So noise of the
    stated size is added once more to a band of the map, in a few realisations:

    - Their mean minus the band without it is the shift. A map that was measured with this noise already carries
      it once. It is not corrected, and counts in full as a standard uncertainty shared by all poses; relative to
      L it applies to the whole map.
    - Their covariance over the poses, times facets of the band over facets of the map, is the scatter of the
      mean over the whole map: facets far from each other are independent. Of N realisations it has rank N − 1 and
      a relative error of 1/√(2(N − 1)) in u.

    Args:
        relief: the whole map.
        directions: (P, 3) unit vectors to the light and to the camera.
        material: the plastic.
        radiance: (P,) nominal radiances of the whole map in 1/sr.
        noise_um: standard deviation, independent in every point, in µm.
        rng: generator.
        on_progress: called at every realisation.
        realisations: how many, at least 2.
    """
    band = best_band(relief)
    plain = relief_radiance(band, *directions, material)
    drawn = []
    for number in range(realisations):
        on_progress("height noise", number, realisations)
        height = band.surface.height_um
        noisy = band.surface.with_height(height + noise_um * rng.standard_normal(height.shape))
        drawn.append(relief_radiance(replace(band, surface=noisy), *directions, material))
    found = np.array(drawn)
    bright = (plain > DARK) & (radiance > DARK)
    gain = np.where(bright, radiance / np.where(bright, plain, 1.0), 1.0)
    area = band.surface.height_um.size / relief.surface.height_um.size
    scatter = np.atleast_2d(np.cov(found.T)) * area * np.outer(gain, gain)
    return [
        Contribution("height noise, mean shift", gain * (found.mean(axis=0) - plain)),
        _partial("height noise, scatter", scatter),
    ]


def ridge_scatter(
    relief: Relief,
    directions: tuple[FloatArray, FloatArray],
    material: Material,
    ridges_seen: int | None = None,
    on_progress: Advance = silent,
) -> Contribution | None:
    """Uncertainty of a mean over few ridges, from the scatter between the ridges of the map.

    The map's ridges are a sample of those of the part. Resampling them with replacement gives a covariance of their
    mean of S/n, where S is the covariance between the n ridges; that limit of many resamplings is taken directly,
    with n − 1 for an unbiased S. Where the camera sees ``ridges_seen`` other ridges, S/ridges_seen adds to it.
    Neighbouring ridges are taken as independent, which underestimates a slow change over the map.

    Returns:
        The contribution, or None for maps with fewer than four whole ridges or without period.
    """
    if relief.pitch_um is None:
        return None
    surface = relief.surface
    width = relief.pitch_um / surface.pixel_x_um
    count = int((surface.shape[1] - 1) / width + 1e-6)
    points = int(np.ceil(width - 1e-6)) + 1
    drawn = []
    for number in range(count):
        start = min(round(number * width), surface.shape[1] - points)
        height = surface.height_um[:, start : start + points]
        if start < 0 or not np.isfinite(height[:-1] + height[1:])[:, :-1].any():
            continue
        on_progress("scatter between ridges", number, count)
        ridge = replace(relief, surface=surface.with_height(height), max_missing_share=1.0)
        drawn.append(relief_radiance(ridge, *directions, material))
    found = np.array([row for row in drawn if np.isfinite(row).all()])
    if len(found) < MIN_RIDGES:
        return None
    share = 1.0 / len(found) + (0.0 if ridges_seen is None else 1.0 / ridges_seen)
    return _partial("scatter between ridges", np.atleast_2d(np.cov(found.T)) * share)


def _partial(source: str, matrix: FloatArray) -> Contribution:
    return Contribution(source, np.sqrt(np.diag(matrix)), "partial", matrix=matrix)
