"""Fit problem: a scene that the models predict, and the readings of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.fit.parameters import OPTIONAL, PARAMETERS
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.bounces import NODES, interreflection
from anisoscope.sim.light.geometry import seating_rotation
from anisoscope.sim.light.material import HeldInterface

IntArray = npt.NDArray[np.intp]
Model = Literal["printed", "corrected"]
Kind = Literal["exposure", "brdf", "difference", "absolute", "michelson", "log_ratio"]

SCALED: tuple[Kind, ...] = ("exposure", "brdf", "difference", "absolute")
RATIOS: tuple[Kind, ...] = ("michelson", "log_ratio")
HORIZON = 1e-3
DARK = 1e-300  # keeps logarithms finite where the printed model is black
COARSE_NODES = 3  # per panel, for a search
_ALPHA_GRID = 0.01
_INDEX_STEP = 0.05
MATTE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("a purely matte surface (Lambert)", ()),
    ("a rough matte surface (Oren-Nayar)", ("matte_deg",)),
)
"""Surfaces without a lobe, and the parameters that they have besides their albedo."""
NO_INTERFACE = 1.0 + 1e-6  # index of a matte surface
_WIDEST_CREST = 0.3  # of the pitch


def interface_alpha(values: Mapping[str, float]) -> float:
    """√(α_u·α_v), rounded to a grid of 1 %."""
    mean = 0.5 * np.log(values["alpha_along"] * values["alpha_across"])
    return float(np.exp(_ALPHA_GRID * np.round(mean / _ALPHA_GRID)))


@dataclass(frozen=True, eq=False)
class Scene:
    """P directions of light and camera in the frame of the sample, and the model that predicts them.

    Attributes:
        to_light: (P, 3) unit vectors.
        to_camera: (P, 3) unit vectors.
        model: "printed" or "corrected".
        bounces: reflections counted by the corrected model; None is all.
        nodes: Gauss-Legendre nodes per panel for two reflections.
        higher: (P,) ratio of all reflections to two, which stands for the third and further ones; None: they are
            followed.
        design: pitch, wall and radii of the crests and feet of the ridges; the parameters stand in place of the rest.
        material: internal reflection and second lobe of the plastic; the parameters stand in place of the rest.
        ridge_angles_deg: (P,) ridge angles where several parts were measured; None: the parameter is used.
        poses: the P poses, where the directions come from a stage and a tilt; else empty.
        convention: how the angles of the poses are counted, or None.
    """

    to_light: FloatArray
    to_camera: FloatArray
    model: Model = "corrected"
    bounces: int | None = None
    nodes: int = NODES
    higher: FloatArray | None = None
    design: RidgeDesign = field(default_factory=lambda: RidgeDesign(100.0, 10.0))
    material: Material = field(default_factory=Material)
    ridge_angles_deg: FloatArray | None = None
    poses: tuple[Pose, ...] = ()
    convention: Convention | None = None

    def radiance(self, values: Mapping[str, float], interface: float) -> FloatArray:
        """(P,) radiances in 1/sr; 0 where light or camera is below the sample's horizon.

        Args:
            values: all parameters by name.
            interface: roughness of the interface table.
        """
        seat = seating_rotation(values["seating_x_deg"], values["seating_y_deg"])
        light, camera = self.to_light @ seat, self.to_camera @ seat
        matte, second = values.get("matte_deg"), self.material.second_lobe
        if "second_weight" in values and "second_width" in values:
            second = values["second_weight"], values["second_width"]
        material = HeldInterface(
            values["alpha_along"],
            values["alpha_across"],
            values["albedo"],
            values["index"] if matte is None else NO_INTERFACE,
            self.material.internal_reflection,
            values.get("tail", 0.0),
            second,
            interface_alpha=interface,
        )
        shape = replace(
            self.design,
            wall=values.get("draft_deg", self.design.wall),
            edge_radius_um=min(values["edge_radius_um"], _WIDEST_CREST * self.design.pitch_um)
            if "edge_radius_um" in values
            else self.design.edge_radius_um,
            foot_radius_um=0.0,
        )
        foot_um = min(
            values.get("foot_radius_um", self.design.foot_radius_um), _WIDEST_CREST * self.design.pitch_um
        )
        above = (light[:, 2] > HORIZON) & (camera[:, 2] > HORIZON)
        angles = self.ridge_angles_deg
        if angles is None:
            angles = np.full(len(light), values["ridge_angle_deg"])
        found = np.zeros(len(light))
        for angle in np.unique(angles):
            here = above & (angles == angle)
            design = replace(shape, ridge_angle_deg=float(angle), height_loss=values["height_loss"])
            if foot_um > 0.0:
                room = max(0.0, design.arcs_um - design.edge_radius_um) if design.edge_radius_um else foot_um
                design = replace(design, foot_radius_um=min(foot_um, room))
            found[here] = self._one_part(light[here], camera[here], design, material, matte)
            if self.follows:
                indirect = self._indirect(light[here], camera[here], design, material)
                found[here] += indirect if self.higher is None else indirect * self.higher[here]
        return found

    @property
    def follows(self) -> bool:
        """Whether light that reflects more than once counts."""
        return self.model == "corrected" and self.bounces != 1

    def _one_part(
        self,
        light: FloatArray,
        camera: FloatArray,
        design: RidgeDesign,
        material: Material,
        matte_deg: float | None,
    ) -> FloatArray:
        if self.model == "printed":
            return printed.radiance(light, camera, design, material)
        return corrected.radiance(light, camera, design, material, matte_deg=matte_deg)

    def _indirect(
        self, light: FloatArray, camera: FloatArray, design: RidgeDesign, material: Material
    ) -> FloatArray:
        bounces = self.bounces if self.higher is None else 2
        return interreflection(light, camera, design, material, bounces, self.nodes)

    def coarse(self) -> "Scene":
        """The same with two reflections at most, coarsely integrated: for a search."""
        return replace(self, bounces=2, nodes=COARSE_NODES, higher=None) if self.follows else self

    def anchored(self, values: Mapping[str, float], interface: float) -> "Scene":
        """The same with third and further reflections as a share of two, as it is at the given values."""
        if not self.follows or self.bounces == 2:
            return self
        direct, two, found = (
            replace(self, bounces=count, higher=None).radiance(values, interface)
            for count in (1, 2, self.bounces)
        )
        lit = two - direct > DARK
        ratio = np.where(lit, found - direct, 1.0) / np.where(lit, two - direct, 1.0)
        return replace(self, higher=ratio)


@dataclass(frozen=True, eq=False)
class Readings:
    """N measured values, each of one direction or of a pair of them.

    Attributes:
        kind: what a value is; "absolute" is the absolute difference.
        first: (N,) index of the direction, of a pair the one it starts from.
        second: (N,) index of the other one of a pair; not used for single values.
        value: (N,) measured values.
        covariance: (N, N) of the values; only its shape counts where the noise is not known.
        noise_known: the covariance has been given with the values.
        labels: N texts that identify the rows.
        assumption: what the covariance rests on, in words.
        gain: (N,) factor between k·L and a single value; 1/cos θi for a BRDF.
    """

    kind: Kind
    first: IntArray
    second: IntArray
    value: FloatArray
    covariance: FloatArray
    noise_known: bool
    labels: tuple[str, ...]
    assumption: str
    gain: FloatArray | None = None

    @property
    def scaled(self) -> bool:
        """The scale k enters."""
        return self.kind in SCALED

    def predicted(self, radiance: FloatArray, k: float) -> FloatArray:
        """(N,) values that these (P,) radiances give."""
        a = radiance[self.first]
        if self.kind in ("exposure", "brdf"):
            return np.asarray(k * a if self.gain is None else k * self.gain * a)
        b = radiance[self.second]
        if self.kind == "log_ratio":
            return np.asarray(np.log(np.maximum(a, DARK) / np.maximum(b, DARK)))
        if self.kind == "michelson":
            return np.asarray((a - b) / np.maximum(a + b, DARK))
        return np.asarray(k * (np.abs(a - b) if self.kind == "absolute" else a - b))

    def by_log_radiance(self, radiance: FloatArray, k: float) -> FloatArray:
        """(N, P) derivative of the values by the logarithms of the radiances."""
        a, b = radiance[self.first], radiance[self.second]
        rows = np.arange(len(self.first))
        found = np.zeros((len(rows), len(radiance)))
        if self.kind in ("exposure", "brdf"):
            found[rows, self.first] = self.predicted(radiance, k)
            return found
        if self.kind in RATIOS:
            weight = np.ones(len(rows))
            if self.kind == "michelson":
                weight = 0.5 * (1.0 - self.predicted(radiance, k) ** 2)
            up, down = weight, weight
        else:
            sign = np.sign(a - b) if self.kind == "absolute" else np.ones(len(rows))
            up, down = k * sign * a, k * sign * b
        found[rows, self.first] += up
        found[rows, self.second] -= down
        return found


@dataclass(frozen=True, eq=False)
class Problem:
    """Free parameters, scene and readings of a fit.

    Attributes:
        scene: the directions and the model.
        readings: the measured values.
        values: every parameter; the free ones are starting points only.
        free: names of the free parameters.

    Raises:
        UsageError: a parameter is free that does not enter, or the model cannot predict such values.
    """

    scene: Scene
    readings: Readings
    values: Mapping[str, float]
    free: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.scene.model == "printed" and self.readings.kind in RATIOS:
            raise UsageError(
                "ratio contrasts of the printed model are far off: fit them by --model corrected"
            )
        if self.scene.model == "printed" and "height_loss" in self.free:
            raise UsageError("the printed model knows no height loss: leave it out of --free")
        if self.scene.model == "printed" and self.scene.material.second_lobe is not None:
            raise UsageError(
                "the printed model has Beckmann's lobe: leave --second-lobe out, or take --model corrected"
            )
        if self.scene.model == "printed" and self.values.get("tail", 0.0) + ("tail" in self.free) > 0.0:
            raise UsageError(
                "the printed model has Beckmann's lobe: leave the tail out, or take --model corrected"
            )
        if self.scene.model == "printed" and OPTIONAL.keys() & {*self.free}:
            raise UsageError(
                f"the printed model knows no {', '.join(n for n in OPTIONAL if n in self.free)}: leave it out of --free"
            )
        if ("second_weight" in self.free) != ("second_width" in self.free):
            raise UsageError(
                "a second lobe has a weight and a width: free second_weight and second_width together"
            )
        if "k" in self.free and not self.readings.scaled:
            raise UsageError("k cancels in ratio contrasts: leave it out of --free")
        if self.scene.ridge_angles_deg is not None and "ridge_angle_deg" in self.free:
            raise UsageError("the ridge angles stand in the table: leave ridge_angle out of --free")
        needed = len(self.free) + (0 if self.readings.noise_known else 1)
        if len(self.readings.value) < max(needed, 1):
            raise UsageError(
                f"{len(self.readings.value)} values cannot determine {len(self.free)} free parameters"
                + ("" if self.readings.noise_known else " and their own scatter")
                + ": measure more poses, or leave parameters out of --free"
            )

    def freed(self, names: Sequence[str], values: Mapping[str, float] | None = None) -> "Problem":
        """The same with these parameters free, and others where they are stated.

        What the model did not have starts at the design, or at a usual value.
        """
        design = self.scene.design
        own = {
            "edge_radius_um": design.edge_radius_um or OPTIONAL["edge_radius_um"],
            "foot_radius_um": design.foot_radius_um or OPTIONAL["foot_radius_um"],
            "draft_deg": OPTIONAL["draft_deg"] if isinstance(design.wall, str) else design.wall,
        }
        started = {name: start for name, start in (OPTIONAL | own).items() if name in names}
        free = tuple(name for name in PARAMETERS if name in names)
        return replace(self, values=started | dict(self.values) | dict(values or {}), free=free)

    def predicted(self, values: Mapping[str, float], interface: float) -> FloatArray:
        """(N,) values of the model for all parameters."""
        radiance = (
            self.scene.radiance(values, interface)
            if "index" not in self.free
            else self._by_index(values, interface)
        )
        return self.readings.predicted(radiance, values["k"])

    def _by_index(self, values: Mapping[str, float], interface: float) -> FloatArray:
        """Radiances by cubic interpolation over the index: every new index would cost a new interface table."""
        middle = int(np.clip(np.floor(values["index"] / _INDEX_STEP), 22, 68))
        nodes = _INDEX_STEP * np.arange(middle - 1, middle + 3)
        total = np.zeros(len(self.scene.to_light))
        for i, node in enumerate(nodes):
            others = np.delete(nodes, i)
            weight = float(np.prod((values["index"] - others) / (node - others)))
            total += weight * self.scene.radiance(dict(values) | {"index": float(node)}, interface)
        return total
