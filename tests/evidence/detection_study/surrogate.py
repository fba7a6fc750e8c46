"""Radiance of one ridge of a part in every view as a polynomial of its state, fitted to renderings of such ridges.

ln L of a place on the ridge is a polynomial of second order in ridge angle, roughnesses, albedo, seating, light angle
and the zeros of stage and tilt, for good ridges and for those of every class of shape defects. It is fitted by least
squares to a design of states out to about three standard deviations. Light that is reflected more than once is so
much weaker that a linear polynomial serves. `error_of` says what the polynomial misses at other states.
"""

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache, Entry
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.light.relief import Relief, shine_maps
from anisoscope.sim.pathtracer.tracer import PathTracer
from detection_study.lobes import lobes_of, plastic_of, quick_shine
from detection_study.product import (
    ALBEDO_SPREAD,
    ALPHA_SPREAD,
    BY_NAME,
    GOOD,
    LIGHT_DEG,
    PITCH_UM,
    RIDGE_ANGLE_SPREAD_DEG,
    SEEN,
    TILT_ZERO_DEG,
    VIEWS,
    WORLDS,
    RigState,
    Specimen,
    World,
    defective,
    nominal,
    rendered_as,
)
from detection_study.sheets import POINTS

TRACED_ROWS, FINE = 12, 1000
"""Rows of a profile that is traced, and its points a pitch for direct light: corners between two points are cut."""
CORNERED = range(901, 1001)
"""Points a pitch for light that reflects more than once: as many as come nearest to all corners of the profile."""
UNITS = np.array(
    [RIDGE_ANGLE_SPREAD_DEG, ALPHA_SPREAD, ALPHA_SPREAD, ALBEDO_SPREAD, 0.1, 0.1, 0.1, TILT_ZERO_DEG, 0.03]
)
"""Standard deviations of the state: ridge angle, roughness along and across, albedo, seating, light, tilt, stage."""
STATES, FEW, MANY, SPREAD = 136, 30, 60, 1.5
"""States to which polynomials of second and first order are fitted, and their standard deviation in that of parts.

Light that is reflected more than once is followed by few paths: ``MANY`` states show its slopes on good ridges."""
PATHS = 1 << 14
CURVE = 61
_STATES = {
    "ridge-angle": ([0], 3.0),
    "roughness-along": ([1], 5.0),
    "roughness-across": ([2], 3.0),
    "roughness": ([1, 2], 5.0),
    "colour": ([3], 5.0),
    "seating-x": ([4], 5.0),
    "seating-y": ([5], 5.0),
    "light-angle": ([6], 5.0),
}
"""Causes that a state describes: its columns, and how far it goes in `UNITS`."""
_POSITIONS = ("seating-x", "seating-y", "light-angle")
_SQUARES = tuple((a, b) for a in range(len(UNITS)) for b in range(a + 1))
_LEAST = 1e-9


def bases_of(kind: str) -> tuple[float, ...]:
    """Extents of a class about which its parts scatter; (0,) for a class whose ridges are those of good parts."""
    if kind not in BY_NAME or BY_NAME[kind].local:
        return (0.0,)
    return (-BY_NAME[kind].extent, BY_NAME[kind].extent) if BY_NAME[kind].signed else (BY_NAME[kind].extent,)


@dataclass(frozen=True)
class SurrogateTask:
    """Which polynomial: world, class, extent of its defect."""

    world: World
    kind: str
    extent: float
    folder: Path | None = None

    @property
    def entry(self) -> Entry:
        """Its place in the cache."""
        return Cache(self.folder).entry(
            "detection-polynomials", [rendered_as(self.world), self.kind, self.extent], __name__
        )


@dataclass(frozen=True, eq=False)
class Surrogate:
    """Polynomials of one class in one world.

    Attributes:
        direct: (1 + K + K(K + 1)/2, V, POINTS) coefficients of ln of the direct light over one pitch.
        dark: (V, POINTS) where shadows reach; the coefficients there are of the light itself.
        indirect: (1 + K, V) coefficients of ln of the light that is reflected more than once.
    """

    direct: FloatArray
    dark: npt.NDArray[np.bool_]
    indirect: FloatArray

    def radiance(self, state: FloatArray) -> FloatArray:
        """(V, POINTS) direct radiance in 1/sr for a (V, K) state in `UNITS`."""
        values = np.einsum("vc,cvp->vp", _terms(state), self.direct)
        return np.asarray(np.where(self.dark, np.maximum(values, 0.0), np.exp(np.minimum(values, 3.0))))

    def reflected(self, state: FloatArray) -> FloatArray:
        """(V,) radiance in 1/sr of light that is reflected more than once."""
        return np.asarray(
            np.exp(np.einsum("vc,cv->v", _terms(state)[:, : 1 + state.shape[1]], self.indirect))
        )


def _terms(states: FloatArray) -> FloatArray:
    squares = np.stack([states[..., a] * states[..., b] for a, b in _SQUARES], axis=-1)
    return np.concatenate([np.ones((*states.shape[:-1], 1)), states, squares], axis=-1)


def state_of(part: Specimen, rig: RigState | None, extent: float, kind: str) -> FloatArray:
    """(V, K) state of a part on a rig in `UNITS`, about a part with the defect alone. Without rig: as described."""
    base = defective(nominal(), kind, extent)
    light, tilt = (0.0, 0.0) if rig is None else (rig.light_deg - LIGHT_DEG, rig.tilt_zero_deg)
    common = [
        part.ridge_angle_deg - base.ridge_angle_deg,
        float(np.log(part.along / base.along)),
        float(np.log(part.across / base.across)),
        float(np.log(part.albedo)),
        *map(float, part.seating_deg),
        light,
        tilt,
        0.0,
    ]
    state = np.tile(common, (len(VIEWS), 1))
    state[:, -1] = part.stage_deg
    return np.asarray(state / UNITS)


def surrogate_of(task: SurrogateTask) -> Surrogate:
    """A polynomial, fitted unless it is cached."""
    return task.entry.result(lambda: _fitted(task), _packed, _unpacked)


def prepare_surrogate(task: SurrogateTask) -> None:
    """Fit a polynomial unless it is cached."""
    surrogate_of(task)


def _packed(found: Surrogate) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, direct=found.direct, dark=found.dark, indirect=found.indirect)
    return stream.getvalue()


def _unpacked(content: bytes) -> Surrogate:
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return Surrogate(stored["direct"], stored["dark"], stored["indirect"])


def _design() -> FloatArray:
    """(STATES, K) states: each followed by its opposite, so that even and odd terms are independent."""
    half = np.random.default_rng(5).standard_normal((STATES // 2, len(UNITS)))
    return SPREAD * np.stack([half, -half], axis=1).reshape(STATES, -1)


def _fitted(task: SurrogateTask) -> Surrogate:
    last = [*range(len(SEEN)), 0]  # the closing view is the first once more
    states = _design()
    few, linear = states[:FEW], slice(None, 1 + len(UNITS))
    bounced = states[: MANY if task.kind == GOOD else FEW]
    # every state has its own paths: with the same ones the slopes would be those of the few that catch much light
    light = _log([reflected_of(task, state, seed) for seed, state in enumerate(bounced, 1)])
    indirect = _polynomial(_terms(bounced)[:, linear], light)[:, last]
    if task.kind == GOOD:
        seen = np.array([direct_of(task, state) for state in states])
        dark = _shadowed(seen)
        direct = _polynomial(_terms(states), np.where(dark, seen, _log(seen)))
        return Surrogate(direct[:, last], dark[last], indirect)
    good = surrogate_of(replace(task, kind=GOOD, extent=0.0))
    seen = np.array([direct_of(task, state) for state in few])
    dark = _shadowed(seen) | good.dark[: len(SEEN)]
    usual = np.einsum("nc,cvp->nvp", _terms(few), good.direct)[:, : len(SEEN)]
    change = _polynomial(_terms(few)[:, linear], np.where(dark, seen, _log(seen) - usual))
    direct = np.where(dark[last], 0.0, good.direct)
    direct[linear] += change[:, last]
    return Surrogate(direct, dark[last], indirect)


def _shadowed(seen: FloatArray) -> npt.NDArray[np.bool_]:
    """(V, POINTS) True where the (N, V, POINTS) radiances of some state are next to those of a shadow."""
    return np.asarray(seen.min(axis=0) < 0.2 * np.median(seen, axis=0).max(axis=-1, keepdims=True))


def _log(values: FloatArray | list[FloatArray]) -> FloatArray:
    return np.asarray(np.log(np.maximum(values, _LEAST)))


def _polynomial(terms: FloatArray, values: FloatArray) -> FloatArray:
    """(C, …) coefficients of (N, C) terms that fit (N, …) values."""
    flat = np.linalg.lstsq(terms, values.reshape(len(values), -1), rcond=None)[0]
    return np.asarray(flat.reshape(-1, *values.shape[1:]))


def _ridge(
    task: SurrogateTask, state: FloatArray
) -> tuple[RidgeDesign, Material, tuple[FloatArray, FloatArray]]:
    """Design, plastic, and directions to light and camera of a state (K,) in `UNITS`."""
    angle, along, across, albedo, x, y, light, tilt, stage = map(float, state * UNITS)
    part = defective(nominal(), task.kind, task.extent)
    whole = lobes_of(task.world).smooth
    material = replace(
        whole,
        alpha_along=whole.alpha_along * part.along * np.exp(along),
        alpha_across=whole.alpha_across * part.across * np.exp(across),
        albedo=min(whole.albedo * float(np.exp(albedo)), 0.99),
    )
    design = RidgeDesign(PITCH_UM, part.ridge_angle_deg + angle, height_loss=part.height_loss)
    poses = tuple(Pose(pose.stage_deg + stage, pose.tilt_deg + tilt) for pose in SEEN)
    seat = seating_rotation(x, y)
    to_light, to_camera = (side @ seat for side in directions(poses, Convention(LIGHT_DEG + light)))
    return design, material, (to_light, to_camera)


def _profile(task: SurrogateTask, design: RidgeDesign, points: int) -> HeightMap:
    """One pitch of a ridge, with ``points`` and one more columns."""
    wear = task.extent if task.kind == "wear" else 0.0
    rows = 5 if wear else 2
    surface = ridges(design, (rows, 3 * points + 1), (PITCH_UM / POINTS, PITCH_UM / points))
    if wear:  # the crests to both sides stand
        surface = edge_wear(surface, wear)
    row = surface.height_um[rows // 2, points : 2 * points + 1]
    # many equal rows: whether a cell is lit and seen says a random point of it
    return HeightMap(np.tile(row, (TRACED_ROWS, 1)), surface.pixel_x_um, surface.pixel_y_um, {})


def cornered(design: RidgeDesign) -> int:
    """The number of points a pitch of `CORNERED` of which some are nearest to foot and edges of the ridge.

    Evenly spaced points cut the corners that are between two of them: 200 a pitch lose a tenth to a quarter of the
    light that reflects more than once, much of it next to the foot.
    """
    facet, loss = design.facet_width_um, design.height_loss
    corners = np.array([facet, facet * loss, facet + design.wall_width_um * (1.0 - loss)]) / design.pitch_um
    counts = np.array(CORNERED)
    places = counts[:, None] * corners
    off = np.abs(places - np.rint(places)).max(axis=1) / counts
    return int(counts[off.argmin()])


def direct_of(task: SurrogateTask, state: FloatArray) -> FloatArray:
    """(P, POINTS) direct radiance over one pitch of smooth ridges in a state (K,), as the world renders it, 1/sr."""
    design, material, sides = _ridge(task, state)
    profile = _profile(task, design, FINE)
    if WORLDS[task.world].traced:
        tracer = PathTracer(profile, plastic_of(task.world, material), pitch_um=PITCH_UM, reflections=1)
        lines = [tracer.direct(light, camera).mean(axis=0) for light, camera in zip(*sides, strict=True)]
    else:
        wide = profile.with_height(np.hstack([profile.height_um[:2, :-1]] * 3 + [profile.height_um[:2, :1]]))
        shines = [quick_shine(light, camera, material) for light, camera in zip(*sides, strict=True)]
        lines = [view[0, FINE : 2 * FINE] for view in shine_maps(Relief(wide, PITCH_UM), shines)]
    return np.array([line.reshape(POINTS, -1).mean(axis=1) for line in lines], dtype=np.float64)


def reflected_of(task: SurrogateTask, state: FloatArray, seed: int = 1) -> FloatArray:
    """(P,) radiance of light that is reflected more than once, likewise; paths are drawn by a seed."""
    design, material, sides = _ridge(task, state)
    if not WORLDS[task.world].traced:
        return indirect_of_groove(task.kind, task.extent, design, material, sides)
    profile = _profile(task, design, cornered(design))
    tracer = PathTracer(profile, plastic_of(task.world, material), pitch_um=PITCH_UM, paths=PATHS, seed=seed)
    return np.array([tracer.indirect(light, camera).mean for light, camera in zip(*sides, strict=True)])


def indirect_of_groove(
    kind: str, extent: float, design: RidgeDesign, material: Material, sides: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """(P,) the same by the predictor's groove, that of worn crests shortened; for the predictor's own world."""
    if kind == "wear":
        design = replace(design, edge_radius_um=extent)
    return corrected.indirect_radiance(*sides, design, material)


def curves_of(world: World, folder: Path | None = None) -> dict[str, tuple[FloatArray, FloatArray]]:
    """(E, P) changes of ln L along every cause that is uniform along the ridges, and (E,) −2 ln of their priors.

    Over `CURVE` extents; between 0 and the extent of a class ln L of worn and of lower ridges is taken as linear.
    Positions of part and lamp have the prior of a diagnosis, Cauchy's distribution of their standard uncertainty.

    Args:
        world: the world.
        folder: of its cache.
    """
    good = surrogate_of(SurrogateTask(world, GOOD, 0.0, folder))
    usual = _log_means(good, np.zeros((1, len(UNITS))))
    found, priors = {}, {}
    for cause, (columns, most) in _STATES.items():
        extents = np.linspace(-most, most, CURVE)
        states = np.zeros((CURVE, len(UNITS)))
        states[:, columns] = extents[:, None]
        found[cause] = _log_means(good, states) - usual
        if cause in _POSITIONS:
            priors[cause] = 2.0 * np.log1p(extents**2)
    for kind in (
        "ridge-angle",
        "roughness",
    ):  # about the extents of their classes, where those of good parts end
        cause, column = BY_NAME[kind].cause, 0 if kind == "ridge-angle" else 2
        for extent in bases_of(kind):
            states = np.zeros((CURVE, len(UNITS)))
            states[:, column] = np.linspace(-3.0, 3.0, CURVE)
            own = surrogate_of(SurrogateTask(world, kind, extent, folder))
            found[cause] = np.vstack([found[cause], _log_means(own, states) - usual])
    for kind in ("height-loss", "wear"):
        own = surrogate_of(SurrogateTask(world, kind, BY_NAME[kind].extent, folder))
        change = _log_means(own, np.zeros((1, len(UNITS)))) - usual
        found[BY_NAME[kind].cause] = np.linspace(0.0, 2.0, CURVE)[:, None] * change
    return {cause: (curve, priors.get(cause, np.zeros(len(curve)))) for cause, curve in found.items()}


def _log_means(own: Surrogate, states: FloatArray) -> FloatArray:
    """(N, P) ln of the mean radiance of the poses at (N, K) states."""
    found = []
    for state in states:
        every = np.tile(state, (len(VIEWS), 1))
        found.append((own.radiance(every).mean(axis=1) + own.reflected(every))[: len(SEEN)])
    return np.asarray(np.log(np.array(found)))


def error_of(task: SurrogateTask, states: FloatArray) -> FloatArray:
    """(N, P) error of ln of the mean direct light of the polynomial at (N, K) states."""
    found, seen = surrogate_of(task), []
    for state in states:
        true = direct_of(task, state).mean(axis=1)
        told = found.radiance(np.tile(state, (len(VIEWS), 1)))[: len(SEEN)].mean(axis=1)
        seen.append(np.log(told / true))
    return np.array(seen)
