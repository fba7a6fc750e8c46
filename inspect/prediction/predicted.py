"""A prediction: radiances and contrasts with their uncertainty, its views in a notebook, and its bytes in a cache.

What predicts is not imported here: a prediction from a cache is shown without it.
"""

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.notebook import axes_or_new, data_frame, html_table
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.prediction.contrast_uncertainty import contrast_covariance
from anisoscope.prediction.monte_carlo import Drawn
from anisoscope.prediction.sensitivity import Budget, Contribution
from anisoscope.sim.light.contrasts import Contrast, consecutive_pairs, contrasts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NEGLECTED_WAVES = "waves, neglected by rays"


@dataclass(frozen=True)
class Predicted:
    """A prediction with its model, conventions and uncertainty.

    Attributes:
        model: "printed", "corrected", "relief" or "wave".
        convention: how the angles are counted.
        poses: P poses.
        radiance: (P,) radiances in 1/sr per unit irradiance perpendicular to the beam.
        contrasts: contrasts of consecutive stage angles.
        k: scale between prediction and measurement; 1 unless it was fitted.
        notes: further findings, such as the pitch of a height map.
        budget: sources of uncertainty, to first order; None if not requested.
        drawn: radiances of a Monte Carlo, or None.
    """

    model: str
    convention: Convention
    poses: tuple[Pose, ...]
    radiance: FloatArray
    contrasts: tuple[Contrast, ...]
    k: float = 1.0
    notes: dict[str, Any] = field(default_factory=dict)
    budget: Budget | None = None
    drawn: Drawn | None = None

    @property
    def covariance(self) -> FloatArray | None:
        """(P, P) covariance of the radiances in 1/sr²: that of the Monte Carlo where there is one."""
        if self.drawn is not None:
            return self.drawn.covariance()
        return None if self.budget is None else self.budget.covariance()

    def contrast_covariance(self, kind: str) -> FloatArray | None:
        """(C, C) covariance of "difference", "michelson" or "log_ratio"; infinite variance where undefined."""
        if self.drawn is not None:
            return self.drawn.contrast_covariance(kind)
        if self.budget is None:
            return None
        return contrast_covariance(self.poses, self.radiance, self.budget.covariance(), kind)

    @property
    def u_radiance(self) -> FloatArray | None:
        """(P,) standard uncertainties of the radiances in 1/sr."""
        covariance = self.covariance
        return None if covariance is None else np.sqrt(np.diag(covariance))

    def __repr__(self) -> str:
        """One line: model, how many poses, and the contrasts."""
        values = ", ".join(
            f"ln {one.from_deg:g}° / {one.to_deg:g}° {one.log_ratio:+.3f}" for one in self.contrasts[:4]
        )
        more = f" and {len(self.contrasts) - 4} more" if len(self.contrasts) > 4 else ""
        return f"Predicted({self.model}, {len(self.poses)} poses: {values or 'no contrast'}{more})"

    def _repr_html_(self) -> str:
        columns = self._columns()
        rows = [
            ["–" if isinstance(value, float) and np.isnan(value) else f"{value:.5g}" for value in row]
            for row in zip(*columns.values(), strict=True)
        ]
        return html_table(f"prediction, {self.model} model", tuple(columns), rows)

    def _columns(self) -> dict[str, list[float]]:
        """By pose: its angles, its radiance, and the ln ratio to the next stage angle at the same tilt."""
        count = len(self.poses)
        u, covariance = self.u_radiance, self.contrast_covariance("log_ratio")
        ratio, u_ratio = np.full(count, np.nan), np.full(count, np.nan)
        pairs = [first for first, _ in consecutive_pairs(self.poses)]
        ratio[pairs] = [one.log_ratio for one in self.contrasts]
        if covariance is not None:
            u_ratio[pairs] = np.sqrt(np.diag(covariance))
        return {
            "stage_deg": [pose.stage_deg for pose in self.poses],
            "tilt_deg": [pose.tilt_deg for pose in self.poses],
            "radiance": self.radiance.tolist(),
            "u_radiance": [float("nan")] * count if u is None else u.tolist(),
            "ln_to_next": ratio.tolist(),
            "u_ln_to_next": u_ratio.tolist(),
        }

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the radiances against the stage angle, a line for every tilt, bars of ±2 u.

        Args:
            axes: matplotlib axes; a new figure by default.
        """
        axes, u = axes_or_new(axes), self.u_radiance
        for tilt in sorted({pose.tilt_deg for pose in self.poses}):
            at = [place for place, pose in enumerate(self.poses) if pose.tilt_deg == tilt]
            angles = [self.poses[place].stage_deg for place in at]
            bars = None if u is None else 2.0 * u[at]
            axes.errorbar(angles, self.radiance[at], bars, fmt="o-", capsize=3, label=f"tilt {tilt:g}°")
        axes.set(xlabel="stage angle [°]", ylabel="radiance [1/sr]", ylim=(0.0, None))
        axes.legend()
        return axes

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """A pandas data frame, a row for every pose; the ln ratio is that to the next stage angle at the same tilt.

        Raises:
            UsageError: pandas is not installed.
        """
        return data_frame(self._columns())


_OF_A_PART = ("absolute", "matrix", "curvature")
"""Arrays of a contribution."""


def packed(found: Sequence[Predicted]) -> bytes:
    """Predictions as bytes, without loss."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    headers = []
    for number, one in enumerate(found):
        arrays[f"{number} radiance"] = one.radiance
        headers.append(
            {
                "model": one.model,
                "convention": asdict(one.convention),
                "poses": [(pose.stage_deg, pose.tilt_deg) for pose in one.poses],
                "k": one.k,
                "notes": one.notes,
                "budget": None if one.budget is None else _budget(one.budget, number, arrays),
                "drawn": one.drawn is not None,
            }
        )
        if one.drawn is not None:
            arrays[f"{number} drawn"] = one.drawn.radiance
    arrays["headers"] = np.frombuffer(json.dumps(headers).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _budget(budget: Budget, number: int, arrays: dict[str, "np.ndarray[Any, Any]"]) -> list[dict[str, Any]]:
    """What is no array of a budget; its arrays are added."""
    arrays[f"{number} budget"] = budget.radiance
    arrays[f"{number} per degree"] = budget.per_degree
    for at, part in enumerate(budget.contributions):
        known = {name: getattr(part, name) for name in _OF_A_PART}
        arrays |= {f"{number} {at} {name}": value for name, value in known.items() if value is not None}
    return [
        {
            "source": part.source,
            "correlation": part.correlation,
            "rectangular": part.rectangular,
            "kind": part.kind,
        }
        for part in budget.contributions
    ]


def unpacked(content: bytes) -> tuple[Predicted, ...]:
    """The predictions in bytes of `packed`."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    found = []
    for number, header in enumerate(json.loads(bytes(arrays["headers"]))):
        poses = tuple(Pose(*pose) for pose in header["poses"])
        radiance = arrays[f"{number} radiance"]
        one = Predicted(
            header["model"],
            Convention(**header["convention"]),
            poses,
            radiance,
            contrasts(poses, radiance),
            header["k"],
            header["notes"],
        )
        if header["budget"] is not None:
            parts = tuple(
                Contribution(
                    **{name: arrays.get(f"{number} {at} {name}") for name in _OF_A_PART},  # type: ignore[arg-type]
                    **part,
                )
                for at, part in enumerate(header["budget"])
            )
            budget = Budget(arrays[f"{number} budget"], parts, arrays[f"{number} per degree"])
            one = replace(one, budget=budget)
        if header["drawn"]:
            one = replace(one, drawn=Drawn(poses, arrays[f"{number} drawn"]))
        found.append(one)
    return tuple(found)
