"""What a print should show: the channels of every pose with everything that makes the prediction uncertain."""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import root
from anisoscope.base.errors import RecipeError
from anisoscope.ink.fitting import SCATTER
from anisoscope.kinds.prints.colour import Eye, eye_of
from anisoscope.kinds.prints.lobe_fit import check_poses
from anisoscope.kinds.prints.model import Scene, State, roughness_matrix, squared_slopes
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.sources import Source, of_channels, of_each, of_poses, shared, total
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.vision import Sensitivities, Vision
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.light.ink.angles import half_vector
from anisoscope.sim.light.ink.ink import InkUncertainty

MODEL = "ink"
ROUGHNESS = "roughness of the ink"
_DARK = 1e-9
OF_ONE_INSPECTION = ("stage angle", "tilt of the arm")
"""Sources that the recipe states of the rig and that differ from one inspection to the next."""
FILM_NM, OF_EACH = 0.5, 0.001
"""Scatter of good prints in form, besides that of sheets: shift by the film, and each channel for itself."""
MOST_SLOPES = 40.0
"""tan²θh/α² beyond which GGX and Beckmann differ by a factor of 10¹⁴, so that no prediction is made."""
_LEANING_DEG = 0.3
"""By which the half angles of poses differ besides, from flakes that lean."""


@dataclass(frozen=True, eq=False)
class PrintExpectation:
    """Predicted channels of the recipe's poses.

    Attributes:
        scene: the good print before the rig.
        eye: conversion of channels to colours.
        poses: P poses.
        channels: (P, 3) radiance in 1/sr that red, green and blue see.
        xyz: (P, 3) XYZ from the spectra, Y = 1 for the perfect diffuser.
        common: sources of uncertainty of the prediction that no fitted parameter is.
        misfit: what the ink file leaves of the light of its prints, which all prints share.
        fitted: those that are: roughness, level, colour, lobe, seating; by what they make uncertain.
        convention: how the angles are counted.
        lamp_distance_mm: from the part to the lamp; None: far away.
    """

    scene: Scene
    eye: Eye
    poses: tuple[Pose, ...]
    channels: FloatArray
    xyz: FloatArray
    common: tuple[Source, ...]
    misfit: tuple[Source, ...]
    fitted: tuple[Source, ...]
    convention: Convention
    lamp_distance_mm: float | None = None

    @property
    def model(self) -> str:
        """Name of the model in the record."""
        return MODEL

    @property
    def surface(self) -> None:
        """A print has no height map."""
        return

    @property
    def optics(self) -> None:
        """Rays or waves: an ink is a measured reflectance, so the question does not arise."""
        return

    @property
    def sources(self) -> tuple[Source, ...]:
        """All sources of uncertainty of the prediction."""
        return self.common + self.misfit + self.fitted


def expect_print(
    recipe: PrintRecipe, light_angle_deg: float, lamp: Illuminant, sensitivities: Sensitivities
) -> PrintExpectation:
    """Predict the poses of a recipe.

    Args:
        recipe: the recipe.
        light_angle_deg: the rig's angle between light and camera.
        lamp: spectrum of the rig's lamp.
        sensitivities: of its camera's red, green and blue pixels.

    Raises:
        InkFileError: the ink cannot be read.
        RecipeError: the print should be black in some pose and channel, a pose lies outside the lobe, or the poses do
            not tell all that is judged.
        ModelError: wavelengths that give no colour, or a pose below the horizon.
    """
    part, ink = recipe.print, recipe.print.read_ink()
    poses = recipe.poses.poses()
    weights = Vision(lamp, sensitivities).weights(ink.nm)
    scene = Scene(ink, part.coverage, part.substrate, poses, light_angle_deg, weights, part.lobe)
    _check_lobe(scene)
    channels = scene.channels()
    if channels.min() <= _DARK:
        at, channel = np.unravel_index(int(channels.argmin()), channels.shape)
        raise RecipeError(
            f"print: at {poses[at].stage_deg:g}°, tilt {poses[at].tilt_deg:g}°, no light is predicted in the "
            f"{('red', 'green', 'blue')[channel]} channel: correct the ink, or leave the pose out"
        )
    check_poses(scene)
    eye = eye_of(scene, lamp)
    return PrintExpectation(
        scene,
        eye,
        poses,
        channels,
        np.asarray(np.pi * scene.spectra() @ xyz_weights(lamp, ink.nm)),
        _common(recipe, scene),
        misfit_of(scene, recipe.print.of_ink(ink)),
        _fitted(recipe, scene),
        Convention(light_angle_deg),
    )


def _check_lobe(scene: Scene) -> None:
    matrix = roughness_matrix(scene.ink, State())
    slopes = squared_slopes(half_vector(*directions(scene.poses, Convention(scene.light_angle_deg))), matrix)
    if slopes.max() > MOST_SLOPES:
        pose, widest = scene.poses[int(slopes.argmax())], np.sqrt(MOST_SLOPES * np.linalg.eigvalsh(matrix)[0])
        raise RecipeError(
            f"poses: at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°, the lobe of {scene.ink.name} has ended, and only "
            f"the form of its tail would show: keep tilts within about {np.degrees(np.arctan(widest)):.0f}°"
        )


def sources_at(recipe: PrintRecipe, expected: PrintExpectation, state: State) -> tuple[Source, ...]:
    """All sources of uncertainty, of prediction and rig, as they act on a print in some state."""
    scene = expected.scene
    of_prediction = (*_common(recipe, scene, state), *_fitted(recipe, scene, state))
    return (*of_prediction, *rig_sources(recipe, expected, state))


def _common(recipe: PrintRecipe, scene: Scene, state: State | None = None) -> tuple[Source, ...]:
    part, rig, count = recipe.print, recipe.uncertainty, 3 * len(scene.poses)
    return (
        shared("c of the ink", "prediction", part.of_ink(scene.ink).c * scene.slope("c", state)),
        shared("substrate", "prediction", part.u_substrate * _of_substrate(scene, state or State())),
        shared("light angle", "prediction", rig.light_angle_deg * scene.slope("light_angle_deg", state)),
        of_each("ink model", "prediction", np.full(count, rig.model_share)),
    )


def misfit_of(scene: Scene, known: InkUncertainty, state: State | None = None) -> tuple[Source, ...]:
    """Errors of an ink that depend smoothly on the half angle, of all channels together and of each for itself.

    The half angle is that from the flakes' mean normal, and of a brushed print as of one that is not.
    """
    if not known.misfit_at_deg:
        return ()
    half = half_vector(*directions(scene.poses, Convention(scene.light_angle_deg)))
    seen = replace(state or State(), alpha=0.0)
    flakes = half @ seating_rotation(-seen.tilt_y_deg, seen.tilt_x_deg)
    widths = np.sqrt(squared_slopes(flakes, roughness_matrix(scene.ink, seen)))
    half_deg = np.degrees(np.arctan(scene.ink.alpha * widths))
    width_deg = 0.5 * np.degrees(np.arctan(scene.ink.alpha))
    near = root(np.exp(-0.5 * (np.subtract.outer(half_deg, half_deg) / width_deg) ** 2))
    # flakes that lean a little show each pose another place of the misfit; half of it is of the inclination of light
    # and camera, which hardly differs between the poses, so that they share its mean square
    near = np.hstack([near, _LEANING_DEG / width_deg * np.eye(len(half_deg))])
    together, each = (
        np.column_stack(
            [np.full(len(size), np.sqrt(np.mean(size**2) / 2.0)), size[:, None] * near / np.sqrt(2.0)]
        )
        for size in (
            np.interp(half_deg, known.misfit_at_deg, share)
            for share in (known.misfit_share, known.misfit_colour_share)
        )
    )
    return (
        Source("misfit of the ink file", "prediction", np.asarray(np.kron(together, np.ones((3, 1))), float)),
        Source("misfit of the ink file in colour", "prediction", np.asarray(np.kron(each, np.eye(3)), float)),
    )


def _of_substrate(scene: Scene, state: State) -> FloatArray:
    """Derivative of ln of the channels with respect to the substrate's reflectance, one-sided where it is black."""
    step = 1e-4
    more = scene.log_channels(replace(state, substrate=state.substrate + step))
    return np.asarray((more - scene.log_channels(state)) / step)


def _fitted(
    recipe: PrintRecipe, scene: Scene, state: State | None = None, known: InkUncertainty | None = None
) -> tuple[Source, ...]:
    known, rig, poses = known or recipe.print.of_ink(scene.ink), recipe.uncertainty, len(scene.poses)
    level = [scene.slope(name, state) for name in ("red", "green", "blue")]
    each = np.stack(level).sum(axis=0).reshape(poses, 3)
    return (
        shared(ROUGHNESS, "prediction", known.alpha_share * scene.slope("alpha", state)),
        shared("level of the ink", "prediction", known.rho_share * np.sum(level, axis=0)),
        of_channels("colour of the ink", "prediction", known.colour_share * each),
        shared("form of the lobe", "prediction", known.lobe * scene.slope("lobe", state)),
        shared("seating tilt about x", "prediction", rig.seating_tilt_deg * scene.slope("seat_x_deg", state)),
        shared("seating tilt about y", "prediction", rig.seating_tilt_deg * scene.slope("seat_y_deg", state)),
    )


def scatter_of_prints(recipe: PrintRecipe, expected: PrintExpectation) -> FloatArray:
    """(3P, 3P) covariance of ln of the channels of good prints about their mean, of which the form counts.

    As sheets of an ink vary, however well its file is known; besides, flakes align otherwise, and films are otherwise
    thick.
    """
    scene, sheets = expected.scene, InkUncertainty(*SCATTER)
    alpha = sheets.alpha_share
    between = [
        shared(name, "prediction", size * scene.slope(name))
        for name, size in (("ratio", alpha), ("skew", alpha), ("shift_nm", FILM_NM))
    ]
    own = [one for one in rig_sources(recipe, expected) if one.name in OF_ONE_INSPECTION]
    each = of_each("ink model", "prediction", np.full(expected.channels.size, OF_EACH))
    return total((*_fitted(recipe, scene, known=sheets), *between, *own, each), expected.channels.size)


def rig_sources(
    recipe: PrintRecipe, expected: PrintExpectation, state: State | None = None
) -> tuple[Source, ...]:
    """Sources of the measurement that the recipe states: what one inspection cannot see; of a print in some state."""
    rig, scene, poses = recipe.uncertainty, expected.scene, len(expected.poses)
    ones, channels = np.ones((poses, 3)), expected.channels if state is None else scene.channels(state)
    arm = scene.slope("arm_deg", state).reshape(poses, 3)
    return (
        shared("white tile", "measurement", rig.scale_share * ones.ravel()),
        of_channels("balance of the channels", "measurement", rig.channel_share * ones),
        of_each("flat field", "measurement", rig.flat_share * ones.ravel()),
        of_each("linearity of the camera", "measurement", rig.linearity_share * ones.ravel()),
        shared("stray light", "measurement", rig.stray_radiance / channels.ravel()),
        of_poses(
            "stage angle", "measurement", rig.stage_deg * scene.slope("stage_deg", state).reshape(poses, 3)
        ),
        _of_tilts(rig.tilt_deg * arm, expected.poses),
        shared("zero of the tilt", "measurement", rig.tilt_zero_deg * arm.ravel()),
    )


def _of_tilts(u: FloatArray, poses: tuple[Pose, ...]) -> Source:
    """An error of every tilt, to which the arm is moved once for all its stage angles."""
    tilts = sorted({pose.tilt_deg for pose in poses})
    factor = np.zeros((*u.shape, len(tilts)))
    for row, pose in enumerate(poses):
        factor[row, :, tilts.index(pose.tilt_deg)] = u[row]
    return Source("tilt of the arm", "measurement", factor.reshape(u.size, len(tilts)))
