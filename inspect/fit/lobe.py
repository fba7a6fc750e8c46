"""Lobe and albedo of a plastic from the radiances of one specimen in many poses, with priors.

The specimen is a flat coupon or a ridged part. ln L of every pose is fitted by weighted least squares, u being the
noise of the pose and `POSE_NOISE` together; parameters that a scan hardly determines keep their priors: seating, light
angle, ridge angle, edge radius, and the amplitude of what reflects between facet and wall. The scale k is free. Two
families of lobes are tried, one with a tail and Beckmann's with a second one mixed in; the Bayesian information
criterion (Schwarz 1978) chooses, and compares both with matte surfaces. A rejected family (`base.rejection`) has its
covariance enlarged by the Birge ratio. Albedo and scale k are then known only together: what parts them is the
amplitude of the lobe, which the family takes from slopes that no pose shows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.rejection import Misfit, misfit
from anisoscope.fit.problem import DARK, MATTE, NO_INTERFACE
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import LONGEST_TAIL, Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.recipe.material_file import Parameter, half_angles_deg, material_at, parameter_values
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation
from anisoscope.sim.light.material import HeldInterface
from anisoscope.sim.light.optics import through

POSE_NOISE = 0.003
"""Relative standard uncertainty of the radiance of a pose besides its noise: lamp, angles, region."""
MIN_POSES = 10
DISCREPANCY = {True: 0.005, False: 0.015}
"""Relative standard uncertainty that a family leaves in a pose, where it fits and where it does not."""

Family = Literal["tail", "second lobe"]
FAMILIES: dict[Family, tuple[Parameter, ...]] = {
    "tail": ("ln_alpha_along", "ln_alpha_across", "tail", "ln_albedo"),
    "second lobe": ("ln_alpha_along", "ln_alpha_across", "ln_second_weight", "ln_second_width", "ln_albedo"),
}
_SECOND_STARTS = ((0.15, 2.0), (0.35, 1.6))
_PRIOR = {  # standard deviations
    "ln_alpha_along": 0.5,
    "ln_alpha_across": 0.5,
    "tail": 0.7,
    "ln_albedo": 0.5,
    "ln_lobe": 0.5,
    "ln_second_weight": 1.0,
    "ln_second_width": 0.5,
    "ln_k": 100.0,
    "seating_x_deg": 0.2,
    "seating_y_deg": 0.2,
    "ridge_angle_deg": 0.1,
    "ln_edge_radius": 0.3,
    "reflections": 0.1,
}
_STEP = {
    "tail": 0.01,
    "seating_x_deg": 0.02,
    "seating_y_deg": 0.02,
    "light_angle_deg": 0.02,
    "ridge_angle_deg": 0.02,
    "ln_edge_radius": 0.02,
}
_LOG_STEP = 0.005
_BOUNDS = {
    "ln_alpha_along": (np.log(0.002), np.log(0.9)),
    "ln_alpha_across": (np.log(0.002), np.log(0.9)),
    "tail": (0.0, LONGEST_TAIL),
    "ln_albedo": (np.log(1e-3), np.log(0.999)),
    "ln_second_weight": (np.log(0.005), np.log(0.6)),
    "ln_second_width": (np.log(1.1), np.log(6.0)),
    "seating_x_deg": (-30.0, 30.0),
    "seating_y_deg": (-30.0, 30.0),
    "light_angle_deg": (-5.0, 5.0),
    "reflections": (0.0, 3.0),
}
_ROUNDS = 3
_GRID = (0.5, 0.75, 1.0, 1.4, 2.0)
_TYPICAL_TAIL = 0.5
_KEPT = 0.7  # share of the prior above which a parameter is the prior's, not the scan's
_BOUND_TOGETHER = 0.9  # correlation
_NUISANCE = {"ln_k", "seating_x_deg", "seating_y_deg", "light_angle_deg"}
_FAR = 2.0  # standard deviations of the prior beyond which the light angle is said
_SEATING_LIMIT_DEG = 1.0  # five times its prior
_WORDS = {
    "ln_alpha_along": "roughness along",
    "ln_alpha_across": "roughness across",
    "tail": "tail",
    "ln_albedo": "albedo",
    "ln_lobe": "amplitude of the lobe",
    "ln_second_weight": "weight of the second lobe",
    "ln_second_width": "width of the second lobe",
    "ln_k": "scale k",
    "seating_x_deg": "seating about x",
    "seating_y_deg": "seating about y",
    "light_angle_deg": "light angle",
    "ridge_angle_deg": "ridge angle",
    "ln_edge_radius": "edge radius",
    "reflections": "amplitude of the reflections",
}

Light = Callable[[FloatArray, FloatArray, RidgeDesign, Material], FloatArray]


@dataclass(frozen=True, eq=False)
class Specimen:
    """What was scanned.

    Attributes:
        design: its ridges; ridge angle and edge radius are centres of their priors.
        direct: radiance of light that reflects once, in 1/sr.
        indirect: what reflections between facet and wall add, in 1/sr; None for a flat coupon.
        shape_known: the shape is that of a measured map, so that ridge angle and edge radius are no parameters.
        name: "coupon" or "part".
        u_light_angle_deg: standard deviation of the prior of the light angle; where it is above 0 the angle is fitted,
            as what it differs by from that of the convention.
    """

    design: RidgeDesign
    direct: Light
    indirect: Light | None
    shape_known: bool
    name: Literal["coupon", "part"]
    u_light_angle_deg: float = 0.0

    @property
    def own_parameters(self) -> tuple[str, ...]:
        """Names of the parameters besides those of the material."""
        names = ["ln_k", "seating_x_deg", "seating_y_deg"]
        if self.u_light_angle_deg > 0.0:
            names.append("light_angle_deg")
        if not self.shape_known:
            names.append("ridge_angle_deg")
            if self.design.edge_radius_um > 0.0:
                names.append("ln_edge_radius")
        if self.indirect is not None:
            names.append("reflections")
        return tuple(names)


def coupon(optics: Optics = POINT_LIKE) -> Specimen:
    """A flat piece of the plastic."""
    return Specimen(RidgeDesign(100.0, 0.0), _direct(optics), None, shape_known=True, name="coupon")


def ridged(design: RidgeDesign, optics: Optics = POINT_LIKE, bounces: int | None = None) -> Specimen:
    """A part with ideal ridges.

    Args:
        design: its ridges.
        optics: cones of light of lamp and lens.
        bounces: largest number of reflections; None counts all, 1 leaves out what reflects between facet and wall.
    """

    def indirect(
        to_light: FloatArray, to_camera: FloatArray, ridges: RidgeDesign, material: Material
    ) -> FloatArray:
        return corrected.indirect_radiance(to_light, to_camera, ridges, material, bounces)

    return Specimen(
        design, _direct(optics), None if bounces == 1 else indirect, shape_known=False, name="part"
    )


def _direct(optics: Optics) -> Light:
    def light(
        to_light: FloatArray, to_camera: FloatArray, ridges: RidgeDesign, material: Material
    ) -> FloatArray:
        def predict(light: FloatArray, camera: FloatArray, plastic: Material) -> FloatArray:
            return corrected.radiance(light, camera, ridges, plastic)

        return through(predict, optics)(to_light, to_camera, material)

    return light


@dataclass(frozen=True, eq=False)
class Scan:
    """Measured radiances of one specimen.

    Attributes:
        poses: P poses.
        convention: how their angles are counted.
        radiance: (P,) in any unit.
        noise: (P,) relative standard uncertainty of each, independent.

    Raises:
        UsageError: too few poses, or a radiance that is none.
    """

    poses: tuple[Pose, ...]
    convention: Convention
    radiance: FloatArray
    noise: FloatArray

    def __post_init__(self) -> None:
        check_poses_suffice(self.poses)
        bad = ~(np.isfinite(self.radiance) & (self.radiance > 0.0))
        if bad.any():
            pose = self.poses[int(np.argmax(bad))]
            raise UsageError(
                f"at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°, the radiance is "
                f"{self.radiance[int(np.argmax(bad))]:g}: ln L needs more than 0; leave the pose out"
            )

    @property
    def u(self) -> FloatArray:
        """(P,) standard uncertainty of ln L."""
        return np.hypot(POSE_NOISE, self.noise)


def check_poses_suffice(poses: Sequence[Pose]) -> None:
    """Raise `UsageError` if the poses cannot determine a lobe."""
    different = len({(pose.stage_deg % 360.0, pose.tilt_deg) for pose in poses})
    if different < MIN_POSES:
        raise UsageError(
            f"{different} poses cannot determine a lobe: at least {MIN_POSES} different ones are needed, 20 or more "
            "are recommended; scan more tilts"
        )


def coupon_poses(tilt_deg: float = 20.0, step_deg: float = 2.5) -> tuple[Pose, ...]:
    """Poses for a flat coupon: along and across its finish, tilts from −tilt to +tilt; 34 by default."""
    count = round(tilt_deg / step_deg)
    return pose_grid((0.0, 90.0), tuple(float(step_deg * n) for n in range(-count, count + 1)))


def part_poses(tilt_deg: float = 20.0, step_deg: float = 10.0) -> tuple[Pose, ...]:
    """Poses for a ridged part: every 45° of the stage, tilts from −tilt to +tilt; 40 by default."""
    count = round(tilt_deg / step_deg)
    angles = tuple(45.0 * n for n in range(8))
    return pose_grid(angles, tuple(float(step_deg * n) for n in range(-count, count + 1)))


@dataclass(frozen=True, eq=False)
class _Model:
    """ln L of a scan's poses as a function of its parameters; centres of the priors are its reference."""

    specimen: Specimen
    poses: tuple[Pose, ...]
    convention: Convention
    base: Material
    lobe: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.lobe, *self.specimen.own_parameters)

    def centre(self) -> FloatArray:
        own = {"ridge_angle_deg": self.specimen.design.ridge_angle_deg, "reflections": 1.0}
        if self.specimen.design.edge_radius_um > 0.0:
            own["ln_edge_radius"] = float(np.log(self.specimen.design.edge_radius_um))
        return np.array(
            [
                *parameter_values(self.base, self.lobe),
                *(own.get(name, 0.0) for name in self.specimen.own_parameters),
            ]
        )

    def state(
        self, values: FloatArray, interface: float | None
    ) -> tuple[Material, RidgeDesign, FloatArray, FloatArray]:
        """Material, ridges, and (P, 3) directions to light and camera."""
        own = dict(zip(self.names, map(float, values), strict=True))
        material = material_at(self.base, self.lobe, values[: len(self.lobe)])
        if interface is not None:
            material = HeldInterface(**vars(material), interface_alpha=interface)
        design = self.specimen.design
        design = replace(
            design,
            ridge_angle_deg=own.get("ridge_angle_deg", design.ridge_angle_deg),
            edge_radius_um=float(np.exp(own["ln_edge_radius"]))
            if "ln_edge_radius" in own
            else design.edge_radius_um,
        )
        seat = seating_rotation(own["seating_x_deg"], own["seating_y_deg"])
        angle = self.convention.light_angle_deg + own.get("light_angle_deg", 0.0)
        to_light, to_camera = directions(self.poses, replace(self.convention, light_angle_deg=angle))
        return material, design, to_light @ seat, to_camera @ seat

    def indirect(self, values: FloatArray) -> FloatArray:
        """(P,) light between facet and wall, of amplitude 1."""
        if self.specimen.indirect is None:
            return np.zeros(len(self.poses))
        material, design, to_light, to_camera = self.state(values, None)
        return self.specimen.indirect(to_light, to_camera, design, material)

    def log_radiance(self, values: FloatArray, indirect: FloatArray, interface: float | None) -> FloatArray:
        """(P,) ln(k L)."""
        own = dict(zip(self.names, map(float, values), strict=True))
        material, design, to_light, to_camera = self.state(values, interface)
        direct = self.specimen.direct(to_light, to_camera, design, material)
        light = direct + own.get("reflections", 1.0) * indirect
        return np.asarray(np.log(np.maximum(light, DARK)) + own["ln_k"])

    def steps(self) -> FloatArray:
        return np.array([_STEP.get(name, _LOG_STEP) for name in self.names])

    def prior(self) -> FloatArray:
        own = _PRIOR | {"light_angle_deg": self.specimen.u_light_angle_deg}
        return np.array([own[name] for name in self.names])

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        wide = (-np.inf, np.inf)
        found = np.array([_BOUNDS.get(name, wide) for name in self.names])
        return found[:, 0], found[:, 1]

    def tangent(self, values: FloatArray) -> "_Tangent":
        """The indirect light near these values, to first order of its logarithm."""
        base, slopes = self.indirect(values), np.zeros((len(self.poses), len(values)))
        if not base.any():
            return _Tangent(values, base, slopes)
        fixed = {"ln_k", "reflections", "ln_edge_radius", "seating_x_deg", "seating_y_deg"}
        low, high = self.bounds()
        for n, (name, step) in enumerate(zip(self.names, self.steps(), strict=True)):
            if name not in fixed:
                up, down = (np.clip(_moved(values, n, side * step), low, high) for side in (1.0, -1.0))
                pair = [np.log(np.maximum(self.indirect(end), DARK)) for end in (up, down)]
                slopes[:, n] = (pair[0] - pair[1]) / (up[n] - down[n])
        return _Tangent(values, base, slopes)

    def jacobian(self, values: FloatArray, tangent: "_Tangent") -> FloatArray:
        """(P, n) derivative of ln(k L) by central differences, one-sided at a bound."""
        low, high = self.bounds()
        columns = []
        for n, step in enumerate(self.steps()):
            up, down = (np.clip(_moved(values, n, side * step), low, high) for side in (1.0, -1.0))
            pair = [self.log_radiance(end, tangent.at(end), None) for end in (up, down)]
            columns.append((pair[0] - pair[1]) / (up[n] - down[n]))
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class _Tangent:
    """Indirect light (P,) at a reference and the (P, n) slopes of its logarithm."""

    values: FloatArray
    light: FloatArray
    slopes: FloatArray

    def at(self, values: FloatArray) -> FloatArray:
        return np.asarray(self.light * np.exp(np.clip(self.slopes @ (values - self.values), -3.0, 3.0)))


def _moved(values: FloatArray, number: int, step: float) -> FloatArray:
    found = values.copy()
    found[number] += step
    return found


@dataclass(frozen=True, eq=False)
class LobeInformation:
    """What a scan says on the parameters.

    Attributes:
        names: n parameters, those of the material first.
        values: (n,) of them.
        covariance: (n, n), priors included.
        prior: (n,) standard deviations of the priors.
        lobe: names of those of the material.
        material: the plastic.
        effective: effective number of parameters that the data determine.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    prior: FloatArray
    lobe: tuple[Parameter, ...]
    material: Material
    effective: float

    @property
    def u(self) -> dict[str, float]:
        """Standard uncertainty of every parameter."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def material_covariance(self) -> FloatArray:
        """Covariance of the parameters of the material alone."""
        count = len(self.lobe)
        return self.covariance[:count, :count]

    def not_identified(self) -> tuple[str, ...]:
        """Lines on parameters that keep their prior, and on those that are known only together."""
        u, lines = np.sqrt(np.diag(self.covariance)), []
        kept = [
            _WORDS[name]
            for name, own, before in zip(self.names, u, self.prior, strict=True)
            if own > _KEPT * before
        ]
        if kept:
            lines.append(f"not determined by this scan (the prior stays): {', '.join(kept)}")
        correlation = self.covariance / np.outer(u, u)
        lines += [
            f"known only together: {_WORDS[other]} and {_WORDS[name]} (correlation {correlation[a, b]:+.2f})"
            for a, name in enumerate(self.names)
            for b, other in enumerate(self.names[:a])
            if abs(correlation[a, b]) > _BOUND_TOGETHER and {name, other} & _NUISANCE
        ]
        return tuple(lines)

    def u_log_ratios(
        self,
        design: RidgeDesign,
        poses: tuple[Pose, ...],
        convention: Convention,
        optics: Optics = POINT_LIKE,
    ) -> FloatArray:
        """(P, P) standard uncertainty of ln(L_i/L_j) of a part's direct light, from the material alone."""
        part = _Model(ridged(design, optics, bounces=1), poses, convention, self.material, self.lobe)
        count = len(self.lobe)
        values = part.centre()
        slopes = part.jacobian(values, part.tangent(values))[:, :count]
        covariance = slopes @ self.material_covariance @ slopes.T
        variance = np.diag(covariance)
        return np.sqrt(np.maximum(variance[:, None] + variance - 2.0 * covariance, 0.0))


def planned(
    specimen: Specimen,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    noise: float = POSE_NOISE,
    family: Family = "tail",
) -> LobeInformation:
    """What a scan would say, before it is taken.

    Args:
        specimen: what is scanned.
        material: about what it is made of.
        poses: P poses.
        convention: how they are counted.
        noise: relative standard uncertainty of the radiance of a pose.
        family: of the lobe.
    """
    if family == "second lobe" and material.second_lobe is None:
        material = replace(material, tail=0.0, second_lobe=_SECOND_STARTS[0])
    model = _Model(specimen, poses, convention, material, FAMILIES[family])
    values = model.centre()
    slopes = model.jacobian(values, model.tangent(values)) / noise
    return _information(model, values, slopes, model.prior())


def _information(model: _Model, values: FloatArray, slopes: FloatArray, prior: FloatArray) -> LobeInformation:
    scaled = slopes * prior  # parameters in units of their priors keep the matrix well conditioned
    inverse = np.linalg.inv(scaled.T @ scaled + np.eye(len(prior)))
    covariance = prior[:, None] * inverse * prior
    material = material_at(model.base, model.lobe, values[: len(model.lobe)])
    effective = float(np.trace(scaled @ inverse @ scaled.T))
    return LobeInformation(model.names, values, covariance, prior, model.lobe, material, effective)


@dataclass(frozen=True, eq=False)
class LobeFit:
    """A fitted plastic.

    Attributes:
        family: of its lobe.
        information: values and covariance, enlarged by the Birge ratio.
        residuals: (P,) ln measured − ln fitted.
        u: (P,) standard uncertainty of ln L.
        other_bic: that of the other family, where it was fitted.
        half_angle_deg: lowest and highest angle between half vector and facet normal.
        misfit: test of the family.
        tests: of all families that were fitted, and of matte surfaces.
    """

    family: Family
    information: LobeInformation
    residuals: FloatArray
    u: FloatArray
    half_angle_deg: tuple[float, float]
    misfit: Misfit
    other_bic: float | None = None
    tests: tuple[Misfit, ...] = ()

    @property
    def material(self) -> Material:
        """The plastic."""
        return self.information.material

    @property
    def residual_over_noise(self) -> float:
        """√(χ²/degrees of freedom): 1 where the family fits and the noise is right."""
        return float(np.sqrt(self.misfit.chi2 / self.misfit.dof))

    @property
    def fits(self) -> bool:
        """Whether the residuals do not reject the family, and no matte surface takes its place."""
        return not self.misfit.rejected and not self.matte

    @property
    def matte(self) -> tuple[str, ...]:
        """Matte surfaces that are not rejected and have the smaller information criterion, in words."""
        surfaces = [one for one in self.tests if one.model not in FAMILIES and not one.rejected]
        return tuple(one.model for one in surfaces if self.misfit.rejected or one.bic < self.misfit.bic)

    @property
    def discrepancy_share(self) -> float:
        """Relative standard uncertainty that the family leaves in a pose, independent of others."""
        return DISCREPANCY[self.fits]

    @property
    def rms_share(self) -> float:
        """Rms of the residuals of ln L."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def warnings(self) -> tuple[str, ...]:
        """Lines on what does not hold."""
        named = tuple(f"these readings are those of {one}: it has no lobe to calibrate" for one in self.matte)
        if not self.misfit.rejected:
            return (*named, *self._light_angle())
        text = (
            f"the family of lobes does not fit: residuals of {100.0 * self.rms_share:.1f} %, "
            f"{self.residual_over_noise:.1f} times their noise; {100.0 * self.discrepancy_share:g} % of every pose "
            "remain as model discrepancy"
        )
        return (text, *named)

    def _light_angle(self) -> tuple[str, ...]:
        found, name = self.information, "light_angle_deg"
        if name not in found.names:
            return ()
        number = found.names.index(name)
        off = float(found.values[number])
        if abs(off) < _FAR * found.prior[number]:
            return ()
        return (
            f"the light is {off:+.2f}° (u {found.u[name]:.2f}°) off the angle of the rig file: measure it",
        )


def fit_lobe(
    scan: Scan,
    specimen: Specimen,
    start: Material,
    families: Sequence[Family] = ("tail", "second lobe"),
    advance: Advance = silent,
) -> LobeFit:
    """Fit the plastic of a specimen.

    Args:
        scan: its radiances.
        specimen: what was scanned.
        start: about what it is made of, the centre of the priors; its index is kept.
        families: which families of lobes are tried.
        advance: progress.

    Raises:
        CalibrationError: a coupon that is not flat.
    """
    found = []
    for number, family in enumerate(families):
        advance(f"fitting the lobe: {family}", number, len(families))
        found.append(_fit_family(scan, specimen, start, family))
    best = min(found, key=lambda one: (one.misfit.rejected, one.misfit.bic))
    others = [one.misfit.bic for one in found if one is not best]
    if specimen.name == "coupon":
        _check_flat(best)
    if best.misfit.rejected:
        best = replace(best, information=_with_amplitude(best.information))
    tests = (*(one.misfit for one in found), *_matte(scan, specimen))
    return replace(best, other_bic=min(others, default=None), tests=tests)


def _with_amplitude(found: LobeInformation) -> LobeInformation:
    """The same with the amplitude of the lobe as a parameter, known only together with albedo and scale."""
    count, u = len(found.lobe), _PRIOR["ln_lobe"]
    names = (*found.names[:count], "ln_lobe", *found.names[count:])
    together = u * np.array(
        [{"ln_albedo": 1.0, "ln_lobe": 1.0, "ln_k": -1.0}.get(name, 0.0) for name in names]
    )
    covariance = np.insert(np.insert(found.covariance, count, 0.0, axis=0), count, 0.0, axis=1)
    return replace(
        found,
        names=names,
        values=np.insert(found.values, count, 0.0),
        covariance=covariance + np.outer(together, together),
        prior=np.insert(found.prior, count, u),
        lobe=(*found.lobe, "ln_lobe"),
    )


def _matte(scan: Scan, specimen: Specimen) -> list[Misfit]:
    """Tests of matte surfaces of the specimen's shape, seated level; only their scale is fitted, and the roughness."""
    to_light, to_camera = directions(scan.poses, scan.convention)

    def chi2(roughness_deg: float) -> float:
        plastic = Material(albedo=1.0, index=NO_INTERFACE)
        light = corrected.radiance(to_light, to_camera, specimen.design, plastic, matte_deg=roughness_deg)
        left = np.log(scan.radiance) - np.log(np.maximum(light, DARK))
        return float(np.sum(((left - np.average(left, weights=scan.u**-2)) / scan.u) ** 2))

    costs = chi2(0.0), min(map(chi2, range(0, 61, 5)))
    return [
        misfit(one[0], cost, len(scan.u), 1 + n)
        for n, (one, cost) in enumerate(zip(MATTE, costs, strict=True))
    ]


def _fit_family(scan: Scan, specimen: Specimen, start: Material, family: Family) -> LobeFit:
    if family == "tail":
        begins = [replace(start, second_lobe=None, tail=start.tail or _TYPICAL_TAIL)]
    else:
        begins = [replace(start, tail=0.0, second_lobe=second) for second in _SECOND_STARTS]
    tried = [_minimise(scan, specimen, begin, family) for begin in begins]
    return min(tried, key=lambda one: one.misfit.bic)


def _minimise(scan: Scan, specimen: Specimen, base: Material, family: Family) -> LobeFit:
    from scipy.optimize import least_squares  # noqa: PLC0415 - start-up time

    model = _Model(specimen, scan.poses, scan.convention, base, FAMILIES[family])
    measured, u = np.log(scan.radiance), scan.u
    centre, prior = model.centre(), model.prior()
    scale = model.names.index("ln_k")
    values, low_high = _started(model, measured, u, centre, scale), model.bounds()
    tangent = _Tangent(values, np.zeros(len(u)), np.zeros((len(u), len(values))))
    for _ in range(_ROUNDS if specimen.indirect is not None else 2):
        tangent = model.tangent(values)
        interface = material_at(base, model.lobe, values[: len(model.lobe)]).alpha_mean

        def residuals(
            internal: FloatArray, tangent: _Tangent = tangent, interface: float = interface
        ) -> FloatArray:
            fitted = model.log_radiance(internal, tangent.at(internal), interface)
            return np.concatenate([(measured - fitted) / u, (internal - centre) / prior])

        before = values
        inside = np.clip(values, low_high[0] + 1e-6, low_high[1] - 1e-6)
        values = least_squares(residuals, inside, bounds=low_high, x_scale=_scales(model), max_nfev=60).x
        if np.all(np.abs(values - before) < 0.2 * model.steps()):
            break
    left = measured - model.log_radiance(values, tangent.at(values), None)
    slopes = model.jacobian(values, tangent) / u[:, None]
    information = _information(model, values, slopes, prior)
    chi2 = float(np.sum((left / u) ** 2))
    dof = max(len(u) - information.effective, 1.0)
    test = misfit(family, chi2, len(u), len(model.names), dof=dof)
    information = replace(information, covariance=test.birge_ratio**2 * information.covariance)
    angles = half_angles_deg(scan.poses, scan.convention, (specimen.design.ridge_angle_deg,))
    span = float(angles.min()), float(angles.max())
    return LobeFit(family, information, left, u, span, test)


def _scales(model: _Model) -> FloatArray:
    return np.minimum(model.prior(), 1.0)


def _started(
    model: _Model, measured: FloatArray, u: FloatArray, centre: FloatArray, scale: int
) -> FloatArray:
    """The best of a grid of roughnesses about the centre, each with its best k."""
    indirect = model.indirect(centre)
    along, across = model.names.index("ln_alpha_along"), model.names.index("ln_alpha_across")
    best, least = centre, np.inf
    for a in _GRID:
        for b in _GRID:
            values = centre.copy()
            values[along] += np.log(a)
            values[across] += np.log(b)
            values = np.clip(values, *model.bounds())
            left = measured - model.log_radiance(values, indirect, model.base.alpha_mean)
            values[scale] = float(np.average(left, weights=u**-2))
            cost = float(np.sum(((left - values[scale]) / u) ** 2))
            if cost < least:
                best, least = values, cost
    return best


def _check_flat(found: LobeFit) -> None:
    """Whether a coupon is flat: facets that lean show as a seating far beyond its prior."""
    own = dict(zip(found.information.names, found.information.values, strict=True))
    lean = float(np.hypot(own["seating_x_deg"], own["seating_y_deg"]))
    if lean > _SEATING_LIMIT_DEG:
        raise CalibrationError(
            f"the coupon is not flat, or not level: its surface leans by {lean:.1f}° against the stage (limit "
            f"{_SEATING_LIMIT_DEG:g}°); take a flat piece and seat it level, or scan a ridged part with --part"
        )
