"""Fit of a print to the channels of all its poses: roughness in every direction, tilt of the flakes, level and colour.

Generalised least squares on ln of the channels. The covariance holds the measurement, and of the prediction what no
parameter is (c, substrate, light angle, ink model); roughness, level and lobe of the ink do not enter: they are
compared with afterwards. c itself is not fitted, because this rig hardly sees it: between light and camera stand 10°.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import rank, whitening
from anisoscope.base.errors import MeasurementError, ModelError, RecipeError
from anisoscope.kinds.prints.model import Scene, State
from anisoscope.kinds.prints.record import LobeRecord, triple
from anisoscope.kinds.prints.sources import Source, total
from anisoscope.sim.light.ink.ink import Ink

PARAMETERS = ("alpha", "ratio", "skew", "tilt_x_deg", "tilt_y_deg", "red", "green", "blue", "lobe")
_ROUNDS = 60
_SETTLED = 1e-9
_WILDEST = {"alpha": 2.5, "tilt_x_deg": 60.0, "tilt_y_deg": 60.0, "lobe": 30.0}
"""Beyond these no print is left: a lobe twelve times as wide as it should be is plain paper's."""
_VAGUE = 0.5
"""Largest standard uncertainty of ln α of a lobe whose width counts as determined."""
_NO_FIT = "the lobe of this print cannot be fitted: is this the recipe's ink, and does the print lie flat?"
_STEP_LIMIT = {
    "alpha": 0.4,
    "ratio": 0.4,
    "skew": 0.4,
    "tilt_x_deg": 4.0,
    "tilt_y_deg": 4.0,
    "lobe": 0.5,
    "shift_nm": 10.0,
}
_TITLES = {
    "alpha": "roughness", "ratio": "ratio of roughness 0°/90°", "skew": "ratio of roughness 45°/135°",
    "tilt_x_deg": "tilt toward +x", "tilt_y_deg": "tilt toward +y", "red": "level of red", "green": "level of green",
    "blue": "level of blue", "lobe": "form of the lobe",
}  # fmt: skip

_DETERMINED = 1e-7  # share of the largest singular value


class NoLobe(MeasurementError):
    """No lobe of any width, height or form fits the channels."""


@dataclass(frozen=True, eq=False)
class PrintFit:
    """The state of a print that explains its channels best.

    Attributes:
        state: the parameters of `PARAMETERS`; the others are zero.
        covariance: (9, 9) of the parameters, from the measurement and what else is uncertain in the fit.
        gain: (9, N) what the parameters do where ln of a channel changes.
        chi2: what the fit leaves.
        dof: channels of all poses less parameters.
        slopes: (N, 9) derivative of ln of the channels at the fit.
    """

    state: State
    covariance: FloatArray
    gain: FloatArray
    chi2: float
    dof: int
    slopes: FloatArray

    def value(self, name: str) -> float:
        """A parameter."""
        return float(getattr(self.state, name))

    def u(self, name: str) -> float:
        """Its standard uncertainty."""
        k = PARAMETERS.index(name)
        return float(np.sqrt(self.covariance[k, k]))

    def record(self, ink: Ink) -> LobeRecord:
        """The lobe as the record holds it; its roughness is that of the recipe's ink times the fitted change."""
        alpha = float(np.sqrt(ink.alpha * ink.across) * np.exp(self.state.alpha))
        return LobeRecord(
            alpha=alpha,
            u_alpha=alpha * self.u("alpha"),
            form=self.value("lobe"),
            u_form=self.u("lobe"),
            tilt_deg=(self.state.tilt_x_deg, self.state.tilt_y_deg),
            levels=triple(np.exp([self.state.red, self.state.green, self.state.blue])),
            chi2=self.chi2,
            dof=self.dof,
        )


def fit_print(
    scene: Scene,
    log_channels: FloatArray,
    sources: tuple[Source, ...],
    *,
    start: State | None = None,
    more: tuple[str, ...] = (),
) -> PrintFit:
    """Fit a print.

    Args:
        scene: the good print before the rig.
        log_channels: (N,) ln of the channels of all poses, channels fastest.
        sources: of uncertainty of the N numbers.
        start: where to begin; the good print if None.
        more: further fields of `State` that are fitted, after those of `PARAMETERS`.

    Raises:
        MeasurementError: the poses do not determine a parameter.
        NoLobe: the fit does not settle, or settles where the width of the lobe is undetermined.
    """
    covariance = total(sources, len(log_channels))
    if rank(covariance) < len(covariance):
        raise MeasurementError(
            "no source of uncertainty is left for some channel, so that nothing can be weighed: "
            "state some under [uncertainty] in the recipe"
        )
    weight, names = whitening(covariance), (*PARAMETERS, *more)
    state, before = start or State(), np.inf
    for turn in range(_ROUNDS):
        off, slopes = log_channels - scene.log_channels(state), _slopes(scene, state, names)
        white, white_off = weight @ slopes, weight @ off
        chi2 = float(white_off @ white_off)
        step, determined = _solved(white, white_off)
        if determined < len(names):
            raise NoLobe(_NO_FIT) if turn else MeasurementError(_undetermined(white, names))
        if abs(before - chi2) < _SETTLED * (1.0 + chi2):
            found = _fitted(state, white, weight, chi2, slopes)
            if found.u("alpha") > _VAGUE:
                break
            return found
        state, before = (
            _moved(scene, state, dict(zip(names, step, strict=True)), log_channels, weight, chi2),
            chi2,
        )
        if any(abs(getattr(state, name)) > most for name, most in _WILDEST.items()):
            break
    raise NoLobe(_NO_FIT)


def _slopes(scene: Scene, state: State, names: tuple[str, ...] = PARAMETERS) -> FloatArray:
    return np.stack([scene.slope(name, state) for name in names], axis=-1)


def _solved(white: FloatArray, off: FloatArray) -> tuple[FloatArray, int]:
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    found, _, rank, _ = np.linalg.lstsq(white / scale, off, rcond=_DETERMINED)
    return np.asarray(found / scale), int(rank)


def _moved(
    scene: Scene, state: State, steps: dict[str, float], target: FloatArray, weight: FloatArray, chi2: float
) -> State:
    """A step of Gauss and Newton, shortened until it helps."""
    share = 1.0 / max(1.0, *(abs(step) / _STEP_LIMIT.get(name, 1.0) for name, step in steps.items()))
    best = None
    for _ in range(12):
        trial = replace(state, **{name: getattr(state, name) + share * float(steps[name]) for name in steps})
        share *= 0.5
        try:
            off = weight @ (target - scene.log_channels(trial))
        except ModelError:  # leans so far that no flake reflects into some pose
            continue
        best = trial
        if float(off @ off) <= chi2:
            break
    if best is None:
        raise NoLobe(_NO_FIT)
    return best


def _fitted(state: State, white: FloatArray, weight: FloatArray, chi2: float, slopes: FloatArray) -> PrintFit:
    covariance = np.asarray(np.linalg.inv(white.T @ white), dtype=np.float64)
    gain = covariance @ white.T @ weight
    return PrintFit(state, covariance, gain, chi2, len(weight) - slopes.shape[1], slopes)


def check_poses(scene: Scene) -> None:
    """Check that the poses determine every parameter.

    Raises:
        RecipeError: they do not.
    """
    slopes = _slopes(scene, State())
    if _solved(slopes, np.zeros(len(slopes)))[1] < len(PARAMETERS):
        raise RecipeError(_undetermined(slopes, PARAMETERS))


def _undetermined(white: FloatArray, names: tuple[str, ...]) -> str:
    """Message that names the parameter that the poses do not determine."""
    scale = np.linalg.norm(white, axis=0)
    _, size, directions = np.linalg.svd(white / np.where(scale > 0.0, scale, 1.0))
    strength = np.pad(size, (0, len(directions) - len(size)))
    lost = directions[strength <= max(_DETERMINED * strength[0], strength[-1])]
    name = names[int(np.argmax(np.sum(lost**2, axis=0)))]
    return (
        f"the poses of the recipe do not determine the {_TITLES.get(name, name)} of a print: add tilts of both signs "
        "and stage angles 90° and 180° apart"
    )


assert set(PARAMETERS) <= {field.name for field in fields(State)}
