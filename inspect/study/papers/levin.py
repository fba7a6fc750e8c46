"""Figures of Levin et al. 2013, Fabricating BRDFs at High Spatial Resolution Using Wave Optics."""

from functools import cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.etching import PatternOptions
from anisoscope.prediction.angular import AngularTask, angular_reflectance
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.report.study_page import Chart, Curve, chart_uri
from anisoscope.sim.design.antimirror import AntiMirror
from anisoscope.sim.design.appearance import mirrored_dots, pattern_under, screen, spectral_density
from anisoscope.sim.design.depths import Depths
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.gradient import PictureTask, design_picture, judged
from anisoscope.sim.design.lobe import SINGLE, LobeTask, design_lobe
from anisoscope.sim.design.models import (
    AntiMirrorModel,
    AnyModel,
    LobeModel,
    MirrorModel,
    model_density,
    random_dot,
)
from anisoscope.sim.design.pattern import dot_task, make_layout
from anisoscope.sim.design.refine import Limits, refine
from anisoscope.sim.design.resolution import expected, tradeoff
from anisoscope.sim.design.targets import TargetTask, design_target
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.wave import claims, sampling
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window, coherence_length_um
from anisoscope.study.papers.rows import Paper, Row, density_picture, picture

NM, UM = 500.0, 0.5
COHERENCE_UM = 16.0
DOT_UM = 112.0
REACH = 0.2
EIGHT_LEVELS_NM = (103.3, 127.9, 166.5)
SEED = 2013


def designed(
    name: str, model: AnyModel, passes_nm: tuple[float, ...] = (NM / 4.0,), wavelength_nm: float = NM
) -> DesignFile:
    """A design under the paper's source, with one etch pass of a quarter wave unless others are given."""
    band = (wavelength_nm, wavelength_nm) if len(passes_nm) == 1 else (400.0, 700.0)
    return DesignFile(
        name=name, model=model, passes_nm=passes_nm, wavelength_nm=wavelength_nm, band_nm=band,
        coherence_um=COHERENCE_UM,
    )  # fmt: skip


@cache
def lobe_model(sigma_x: float, sigma_y: float) -> LobeModel:
    """Mixture of step widths for a Gaussian lobe at 500 nm."""
    found = design_lobe(*(LobeTask(sigma, coherence_um=COHERENCE_UM) for sigma in (sigma_x, sigma_y)))
    (wx, px), (wy, py) = ((a.widths_um.tolist(), a.probabilities.tolist()) for a in (found.x, found.y))
    return LobeModel(widths_x_um=tuple(wx), p_a_x=tuple(px), widths_y_um=tuple(wy), p_a_y=tuple(py))


def anti_mirror(
    many: tuple[int, int], widths: tuple[float, float], *, crossed: bool = False
) -> AntiMirrorModel:
    """Blocks of two levels."""
    return AntiMirrorModel(arrangement=many, widths_um=widths, levels=2, crossed=crossed, folded=crossed)


def _sample(design: DesignFile, dot_um: float = DOT_UM) -> tuple[FloatArray, FloatArray]:
    """Heights of one random dot and its (161, 161) BRDF for light from above, |h| ≤ 0.2."""
    levels = np.asarray(design.depths.levels_um)
    points = round(dot_um / design.grid_um)
    assert not isinstance(design.model, MirrorModel)
    assert isinstance(design.model, LobeModel | AntiMirrorModel)
    labels = random_dot(
        design.model, levels.size, points, design.grid_um, design.min_width_um, np.random.default_rng(SEED)
    )
    task = AngularTask((NM,), reach=2.0 * REACH, lamp_half_angle_deg=0.9)
    found = angular_reflectance(HeightMap(levels[labels], design.grid_um, design.grid_um), task)
    return levels[labels], found.brdf[0]


def _window_picture(heights: FloatArray, caption: str) -> tuple[str, str]:
    part = np.asarray(heights[:128, :128], dtype=np.float64)
    grey = (part - part.min()) / max(float(np.ptp(part)), 1e-9)
    return picture(np.asarray(grey, dtype=np.float64), caption)


def fig_1() -> Row:
    """Anisotropic dots at two orientations change brightness when the lamp goes round."""
    designs = (designed("wide x", lobe_model(0.04, 0.01)), designed("wide y", lobe_model(0.01, 0.04)))
    y, x = np.mgrid[-1:1:48j, -1:1:48j]
    layout = make_layout(
        (np.hypot(x, y) < 0.6).astype(np.int64),
        designs,
        np.random.default_rng(SEED),
        PatternOptions(DOT_UM, 2),
    )
    views = [pattern_under(layout, designs, *h) for h in ((0.06, 0.0), (0.0, 0.06))]
    side, above = (float(each[0] / each[1]) for _, each in views)
    top = max(float(each.max()) for _, each in views)
    pictures = [
        picture(np.asarray(np.kron(one / top, np.ones((4, 4))) ** (1 / 2.2)), words)
        for (one, _), words in zip(views, ("lamp along x, h = 0.06", "lamp along y, h = 0.06"), strict=True)
    ]
    return Row(
        "Fig. 1", "a wafer of anisotropic dots of 112 µm: the image inverts when the lamp turns by 90°",
        "the image is inverted (photographs)",
        f"ground over figure {side:.3g} with the lamp along x, {above:.3g} along y",
        "order", side > 1.0 > above,
        "anisoscope design pattern disc.png --classes wide-x.toml,wide-y.toml --out disc.npz --html disc.html",
        "The photographs are of a wafer that we do not have; ours is the simulation.", pictures,
    )  # fmt: skip


def bump(pitch_um: float, points: int) -> FloatArray:
    """(points,) heights of one period whose slopes are Gaussian with σ = 0.04 at every pitch."""
    from scipy.special import ndtri  # noqa: PLC0415 - slow to import

    share = (np.arange(points) + 0.5) / points
    slope = 0.04 * np.asarray(ndtri(share), dtype=np.float64)
    return np.cumsum(slope) * (pitch_um / points)


@cache
def scaled_bumps(pitches_um: tuple[float, ...]) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
    """(h, wave density, geometric density) of the same bump repeated at each pitch, under a source of 2°."""
    window = Window(Extent("rect", float(np.radians(2.0))))
    found = []
    for pitch in pitches_um:
        points = 256
        heights = np.tile(bump(pitch, points), max(4, round(1024.0 / pitch)))
        spread = angular_map(WaveSurface.of(heights, pitch / points), UM, window)
        f = np.linspace(-0.8, 0.8, 1601)
        wave = spread.at(0.5 * UM * f)
        found.append((0.5 * UM * f, wave, slope_density(heights, pitch / points, f, UM, window)))
    return tuple(found)


def fig_2() -> Row:
    """The same slopes at smaller and smaller pitch leave the geometric limit."""
    pitches = (2.0, 8.0, 32.0, 128.0)
    curves = scaled_bumps(pitches)
    off = [float(np.linalg.norm(wave - rays) / np.linalg.norm(rays)) for _, wave, rays in curves]
    h, wave, _ = curves[0]
    lines = np.arange(-3, 4) * UM / (2.0 * pitches[0])
    reach = 0.5 * np.radians(2.0) / 2.0 + 1e-3
    near = np.min(np.abs(h[:, None] - lines), axis=1) < reach
    share = float(wave[near].sum() / wave.sum())
    charts = [
        (
            chart_uri(
                Chart(f"pitch {pitch:g} µm", "h_x [1]", "density [µm]",
                      (Curve("waves", h, w), Curve("rays", h, g, dashed=True)), points=False)
            ),
            f"pitch {pitch:g} µm",
        )
        for pitch, (h, w, g) in zip(pitches, curves, strict=True)
    ]  # fmt: skip
    return Row(
        "Fig. 2", "the same slopes at pitches of 2, 8, 32 and 128 µm under a source of 2°",
        "2 µm: a set of impulses; large pitches approach the geometric prediction",
        "relative difference from rays " + ", ".join(f"{one:.2f}" for one in off)
        + f"; at 2 µm {100.0 * share:.1f} % of the light is in the grating orders",
        "shape", off[0] > off[1] > off[2] > off[3] and off[3] < 0.1 and share > 0.97,
        "anisoscope research papers --only levin",
        "The paper does not print its surface; ours has Gaussian slopes of σ = 0.04, the same at every pitch.",
        charts,
    )  # fmt: skip


def fig_3() -> Row:
    """Sizes of dot, source and coherence."""
    wide, narrow = (coherence_length_um(UM, float(np.radians(angle))) for angle in (1.8, 0.4))
    return Row(
        "Fig. 3 and section 2.2", "drawing: coherence length Δc = λ/Δa and dot Δd",
        "Δc = 16 µm at 1.8°, 80 µm at 0.4° (λ = 0.5 µm); Δd = 0.112 mm is 220 dpi",
        f"{wide:.1f} µm at 1.8° (agrees), {narrow:.1f} µm at 0.4° (differs); "
        f"0.112 mm is {25.4 / 0.112:.1f} dpi (differs)",
        "number", abs(wide - 16.0) < 0.5,
        "anisoscope design resolution wide.toml",
        f"Judged by 16 µm at 1.8° alone. By Δc = λ/Δa 0.4° gives {narrow:.1f} µm, 10 % less than the printed 80, "
        "which is that of 0.36°; 220 dpi are 115.5 µm.",
    )  # fmt: skip


def fig_4() -> Row:
    """A random staircase."""
    rng = np.random.default_rng(SEED)
    heights = sampling.steps_profile(
        sampling.Widths((2.0, 3.0, 5.0), (0.5, 0.3, 0.2)), (0.0, 0.125), 256, 0.25, rng
    )
    x = np.asarray(np.arange(256) * 0.25, dtype=np.float64)
    chart = Chart("", "x [µm]", "height [nm]", (Curve("", x, 1e3 * heights),), points=False)
    return Row(
        "Fig. 4", "drawing: steps of random widths and heights",
        "no values", "a sample of sampling process 1 with widths of 2, 3 and 5 µm", "none", None,
        "anisoscope research papers --only levin", "A drawing: there is nothing to compare.",
        [(chart_uri(chart), "64 µm of a sample")],
    )  # fmt: skip


def fig_5() -> Row:
    """Glossy lobes of three widths and an anisotropic one."""
    sigmas = ((0.04, 0.04), (0.02, 0.02), (0.01, 0.01), (0.04, 0.01))
    h = np.linspace(0.0, 0.25, 501)
    pictures, widths, side = [], [], []
    for sigma_x, sigma_y in sigmas:
        model = lobe_model(sigma_x, sigma_y)
        heights, observed = _sample(designed("lobe", model))
        caption = f"σ {sigma_x:g} × {sigma_y:g}"
        pictures += [
            _window_picture(heights, f"{caption}: 32 µm of the surface"),
            density_picture(observed, f"{caption}: one dot, |h| ≤ 0.2"),
            density_picture(observed, f"{caption}: contrast raised", 0.4),
        ]
        widths.append(model.axes(2.0)[0].mean_um)
        line = claims.lobe(2.0 * h / UM, np.array(model.widths_x_um), np.array(model.p_a_x), COHERENCE_UM)
        side.append(
            (
                _secondary(line),
                _secondary(claims.blurred_sinc2(2.0 * h / UM, SINGLE * UM / sigma_x, COHERENCE_UM)),
            )
        )
    fewer = [f"{100.0 * mixed:.1f} instead of {100.0 * alone:.1f} %" for mixed, alone in side[:3]]
    return Row(
        "Fig. 5", "glossy lobes: isotropic at three widths (a–c), anisotropic (d); secondary lobes",
        "wider features give narrower lobes; several widths reduce the secondary lobes, which are visible only with "
        "raised contrast",
        "mean step " + ", ".join(f"{one:.1f}" for one in widths[:3]) + " µm for σ 0.04, 0.02, 0.01; secondary lobes "
        + ", ".join(fewer) + " with the best single width",
        "order", widths[0] < widths[1] < widths[2] and all(mixed < alone for mixed, alone in side),
        "anisoscope design lobe --sigma 0.04 --sigma-y 0.01 --name wide --out wide.toml --html wide.html",
        "σ is ours: the paper does not print the widths of its lobes.", pictures,
    )  # fmt: skip


def _secondary(line: FloatArray) -> float:
    """Height of the first secondary lobe over the peak at the start; 0 where the line only falls."""
    rising = np.flatnonzero(np.diff(line) > 0.0)
    return float(line[rising[0] :].max() / line[0]) if rising.size else 0.0


def eq_15() -> Row:
    """Least squares for targets other than Gaussian lobes."""
    h = np.linspace(-REACH, REACH, 81)
    x, y = np.meshgrid(h, h)
    targets = {
        "Gaussian": np.exp(-0.5 * (x**2 + y**2) / 0.04**2),
        "bar": ((np.abs(x) < 0.08) & (np.abs(y) < 0.03)).astype(np.float64),
        "spot beside the mirror direction": np.exp(-0.5 * ((x - 0.08) ** 2 + y**2) / 0.02**2),
    }
    pictures, missed = [], []
    for name, wanted in targets.items():
        found = design_target(TargetTask(wanted, max_width_um=12.0, grid_um=1.0))
        missed.append(found.unreachable_share)
        pictures += [
            density_picture(wanted, f"{name}: wanted"),
            density_picture(found.achieved, f"{name}: closest"),
        ]
    texts = ", ".join(f"{100.0 * one:.0f} % ({name})" for one, name in zip(missed, targets, strict=True))
    return Row(
        "Eq. 15", "least squares for any target: lobes by mixtures of widths",
        "solved for a Gaussian lobe; the family is more restricted than that of facets (section 5)",
        f"wanted light out of reach: {texts}", "order", missed[0] < 0.05 < missed[1] < missed[2],
        "anisoscope design picture bar.png --nearest --png bar-closest.png",
        "Per area and blurred by the source; every mixture is symmetric about both axes.", pictures,
    )  # fmt: skip


def section_5() -> Row:
    """What random steps cannot do, gradients can."""
    side = 32
    y, x = np.mgrid[-1.0 : 1.0 : side * 1j, -1.0 : 1.0 : side * 1j]
    wanted = np.exp(-8.0 * ((x - 0.3) ** 2 + (y - 0.2) ** 2)) + 0.6 * (
        (np.abs(x + 0.4) < 0.3) & (np.abs(y) < 0.5)
    )
    task = PictureTask(
        wanted[..., None],
        Depths((17.2, 34.4, 68.8, 137.5), (550.0, 550.0)).levels_um,
        cells=128,
        coherence_um=24.0,
    )
    found = judged(design_picture(task, np.random.default_rng(SEED), 80))
    return Row(
        "Section 5", "limits: not as general as facets, no colour", "“not as general as … geometric optics approaches”",
        f"a picture without symmetry from 16 levels by gradients: SSIM {found.ssim:.2f}", "none", None,
        "anisoscope design hologram picture.png --picture-light d65 --png unit.png",
        "Not in the paper: cells of 0.5 µm (electron beam) and 16 levels lift this limit, in colour too.",
        [density_picture(wanted, "wanted"), picture(found.srgb[::-1, :, 0], "achieved")],
    )  # fmt: skip


def fig_6() -> Row:
    """Trade-off of spatial and directional resolution."""
    design = designed("lobe", lobe_model(0.02, 0.02))
    found = tradeoff(design, ((16.0, 16.0), (160.0, 16.0), (160.0, 80.0)), 3, np.random.default_rng(SEED))
    h = np.linspace(-REACH, REACH, 161)
    pictures = [density_picture(expected(design, COHERENCE_UM, h, 160.0), "(a) expected")]
    names = (
        "(b) Δd = Δc = 16 µm, n = 1",
        "(c) Δd 160 µm, Δc 16 µm, n = 100",
        "(d) Δd 160 µm, Δc 80 µm, n = 4",
    )
    pictures += [density_picture(one.observed, name) for one, name in zip(found, names, strict=True)]
    one, hundred, four = (each.error for each in found)
    return Row(
        "Fig. 6", "a dot against the expectation: n = (Δd/Δc)² windows of 1, 100 and 4",
        "(b) noisy, (c) a reasonable approximation, (d) noisy again",
        f"relative error {one:.2f}, {hundred:.3f} and {four:.2f}", "order", 2.0 * hundred < four < one,
        "anisoscope design resolution wide.toml --sizes 16:16,160:16,160:80 --png resolution.png", "", pictures,
    )  # fmt: skip


def fig_7() -> Row:
    """Anti-mirrors: their holes and rings."""
    kinds = (
        ("a", (2, 2), (2.0, 2.0), False), ("b", (4, 4), (2.0, 2.0), False), ("c", (2, 2), (4.0, 4.0), False),
        ("d", (4, 1), (2.0, 2.0), False), ("e", (1, 4), (2.0, 2.0), False), ("f", (2, 2), (2.0, 4.0), False),
        ("g", (4, 2), (2.0, 4.0), False), ("i", (2, 2), (2.0, 2.0), True),
    )  # fmt: skip
    pictures, constants = [], []
    for letter, many, widths, crossed in kinds:
        _, observed = _sample(designed("anti", anti_mirror(many, widths, crossed=crossed)))
        shape = "crossed" if crossed else f"{many[0]} × {many[1]}"
        pictures.append(
            density_picture(observed, f"({letter}) {shape} steps of {widths[0]:g} × {widths[1]:g} µm")
        )
    for count, width in ((2, 2.0), (3, 2.0), (4, 2.0), (2, 4.0)):
        f = np.linspace(0.0, 0.5 / width, 4001)
        line = AntiMirror((count, count), (width, width), count * count if count == 3 else 2).density(
            f, np.zeros(1), np.inf
        )[0]
        constants.append(2.0 * float(f[int(np.argmax(line > 0.5 * line.max()))]) * count * width)
    spread = float(np.ptp(constants) / np.mean(constants))
    return Row(
        "Fig. 7", "anti-mirrors of m_x × m_y steps: no light in the mirror direction",
        "the hole is 1/(m·a0) wide, the ring is set by a0; outer products have a dark cross",
        f"width of the hole at half height {np.mean(constants):.2f}/(m·a0), the same within {100.0 * spread:.0f} % "
        "for m = 2, 3, 4 and a0 = 2, 4 µm",
        "shape", spread < 0.15,
        "anisoscope design antimirror --arrangement 2,2 --width 2 --name hole --out hole.toml --html hole.html",
        "Eq. 17 prints a sinc where the sum is a Dirichlet kernel: 14.7 % of the peak at m = 2.", pictures,
    )  # fmt: skip


def _spike_colour(design: DesignFile) -> tuple[FloatArray, float]:
    """Linear sRGB of what the spike adds in the mirror direction, and its luminance over that of the lobe."""
    nm = np.arange(400.0, 701.0, 10.0)
    weights = xyz_weights(standard("d65"), nm)
    zero = np.zeros(1)
    whole = spectral_density(design, tuple(nm.tolist()), zero)[:, 0, 0] @ weights
    alone = [
        model_density(design.model, zero, zero, COHERENCE_UM * one / design.wavelength_nm, DOT_UM, 0.0)[0, 0]
        / (1e-3 * one) ** 2
        for one in nm
    ]
    lobe = np.asarray(alone) @ weights
    return linear_srgb(whole - lobe), float((whole - lobe)[1] / lobe[1])


def fig_8() -> Row:
    """White light on two and on eight levels."""
    model = lobe_model(0.04, 0.04)
    two = designed("2 levels", model, (550.0 / 4.0,), 550.0)
    eight = designed("8 levels", model, EIGHT_LEVELS_NM, 550.0)
    colour, spike = _spike_colour(two)
    _, faint = _spike_colour(eight)
    magenta = float(colour[1] / min(colour[0], colour[2]))
    h = np.linspace(0.0, REACH, 401)
    halves = []
    for nm in (450.0, 650.0):
        line = spectral_density(eight, (nm,), h)[0, 0]
        halves.append(float(h[int(np.argmax(line < 0.3 * line[40]))]))
    pictures = [(screen(one, white=True), f"{one.name}: the lobe under white light") for one in (two, eight)]
    return Row(
        "Fig. 8", "white light on 2 levels (zero mean at 550 nm) and on 8 levels",
        "2 levels: a magenta spike; 8 levels: a nearly white lobe, a little wider in red than in blue",
        f"spike over lobe {spike:.2f} with 2 levels, its green {magenta:.2f} of its red and blue; {faint:.3f} with 8 "
        f"levels; the lobe at 650 nm is {halves[1] / halves[0]:.2f} times as wide as at 450 nm",
        "order", magenta < 0.6 and abs(faint) < 0.1 * spike and halves[1] > halves[0],
        "anisoscope design lobe --sigma 0.04 --depths 103.3,127.9,166.5 --band 400,700 --name white --out white.toml "
        "--html white.html",
        "", [picture(one.srgb, caption) for one, caption in pictures],
    )  # fmt: skip


def fig_9() -> Row:
    """Lobes on a diffuse screen."""
    designs = (
        *(designed(f"σ {s:g}", lobe_model(s, s)) for s in (0.04, 0.02, 0.01)),
        designed("anisotropic", lobe_model(0.04, 0.01)),
        designed("anti-mirror", anti_mirror((2, 2), (2.0, 2.0))),
        designed("anisotropic anti-mirror", anti_mirror((4, 1), (2.0, 2.0))),
    )
    pictures = [picture(screen(one, white=False).srgb, f"{one.name}, 550 nm") for one in designs]
    return Row(
        "Fig. 9", "photographs of lobes on a diffuse screen under a line of 500 or 550 nm", "photographs only",
        "the same kinds of lobes, simulated", "none", None,
        "anisoscope design lobe --sigma 0.02 --name lobe --out lobe.toml --html lobe.html",
        "Photographs of a wafer that we do not have.",
        pictures,
    )  # fmt: skip


def fig_10() -> Row:
    """Dots mirrored in designs, under white light and one line."""
    two = designed("2 levels", lobe_model(0.04, 0.04), (550.0 / 4.0,), 550.0)
    _, white = _spike_colour(two)
    line = two.depths.tau_at(550.0) ** 2
    designs = (
        two,
        designed("narrower", lobe_model(0.02, 0.02), (550.0 / 4.0,), 550.0),
        designed("anti-mirror", anti_mirror((2, 2), (2.0, 2.0)), (550.0 / 4.0,), 550.0),
    )
    pictures = [
        picture(mirrored_dots(one, white=light).srgb, f"{one.name}, {'white' if light else '550 nm'}")
        for one in designs
        for light in (True, False)
    ]
    return Row(
        "Fig. 10", "a plane of dots mirrored in the wafer, under white light and 550 nm",
        "the dots take the shape of the lobe; the magenta spike is much weaker at 550 nm",
        f"spike over lobe {white:.2f} under white light, {line:.4f} at 550 nm", "order", line < 1e-3 < white,
        "anisoscope design lobe --sigma 0.04 --wavelength 550 --name green --out green.toml --html green.html",
        "Photographs in the paper; there the spike stays a little because of over-etching "
        "(`design` lists it under tolerances).", pictures,
    )  # fmt: skip


def fig_11() -> Row:
    """Mirror background, and anti-mirror over a narrow lobe."""
    nm = np.arange(400.0, 701.0, 20.0)
    luminance = xyz_weights(standard("d65"), nm)[:, 1]

    def bright(design: DesignFile, h: float) -> float:
        return float(spectral_density(design, tuple(nm.tolist()), np.array([h]))[:, 0, 0] @ luminance)

    mirror = DesignFile(name="mirror", model=MirrorModel(), passes_nm=(), band_nm=(400.0, 700.0))
    narrow, wide = (designed(f"σ {s:g}", lobe_model(s, s)) for s in (0.01, 0.04))
    anti = designed("anti-mirror", anti_mirror((2, 2), (2.0, 2.0)))
    at_mirror = bright(mirror, 0.0) / bright(wide, 0.0), bright(mirror, 0.05) / bright(wide, 0.05)
    kids = bright(anti, 0.005) / bright(narrow, 0.005), bright(anti, 0.06) / bright(narrow, 0.06)
    return Row(
        "Fig. 11", "patterns under two lights: mirror background; anti-mirror over a narrow lobe",
        "the mirror is bright in its direction only; the anti-mirror is darker at small angles, brighter at large ones",
        f"mirror over lobe {at_mirror[0]:.0f} in the mirror direction, {at_mirror[1]:.1e} beyond; anti-mirror over "
        f"narrow lobe {kids[0]:.2f}, then {kids[1]:.1f}",
        "order", at_mirror[0] > 1.0 > at_mirror[1] and kids[0] < 1.0 < kids[1],
        "anisoscope design pattern disc.png --classes hole.toml,mirror --out holes.npz --html holes.html",
        "Photographs in the paper; ours is the brightness of the classes.",
    )  # fmt: skip


def fig_12() -> Row:
    """Derivation: nothing to compute."""
    return Row(
        "Fig. 12", "drawing: phases of a distant source and viewer (Eq. 19 to 28)", "no values", "–", "none", None,
        "", "A drawing. Eq. 23 has 1/λ for a surface; a profile needs λ^−½ (page on wave optics).",
    )  # fmt: skip


def widest_lobe() -> Row:
    """Section 3.1: widest lobe of 2 µm features."""
    f = np.linspace(0.0, 1.0, 4001)
    line = claims.lobe(f, np.array([2.0]), np.array([1.0]))
    zero = UM * float(f[int(np.argmax(line < 1e-6 * line[0]))])
    return Row(
        "Section 3.1", "first zero of the lobe of 2 µm steps at 500 nm", "v_x = 0.25, the lobe is 30° wide",
        f"v_x = {zero:.3f}, {2.0 * np.degrees(np.arcsin(zero)):.1f}° wide", "number", abs(zero - 0.25) < 1e-3,
        "anisoscope design lobe --sigma 0.06",
    )  # fmt: skip


def levels() -> Row:
    """Eq. 18: levels needed under white light."""
    sets = ((127.3,), (107.3, 157.5), EIGHT_LEVELS_NM)
    eps = [Depths(one, (400.0, 700.0)).epsilon for one in sets]
    return Row(
        "Eq. 18", "largest mean phase |τ| from 400 to 700 nm with 2, 4 and 8 levels", "good results with 4 to 8 depths",
        ", ".join(f"{one:.3f}" for one in eps), "order", eps[0] > 4.0 * eps[1] > 12.0 * eps[2],
        "anisoscope design depths --levels 8 --band 400,700",
        "As printed, Eq. 18 lacks the modulus and a factor of 2.",
    )  # fmt: skip


@cache
def speckle_errors(windows: tuple[int, ...]) -> tuple[float, ...]:
    """Rms of sampled spectra of 2 µm steps against claim 1, over the peak, for numbers of windows."""
    rng = np.random.default_rng(SEED)
    window = Window(Extent("rect", UM / COHERENCE_UM))
    found = []
    for many in windows:
        squares = []
        for _ in range(8 if many < 256 else 3):
            heights = sampling.steps_profile(sampling.Widths((2.0,)), (0.0, 0.125), 64 * many, 0.25, rng)
            spread = angular_map(WaveSurface.of(heights, 0.25, cells=True), UM, window)
            inside = np.abs(spread.frequency_x) < 1.0
            wanted = claims.lobe(spread.frequency_x[inside], np.array([2.0]), np.ones(1), COHERENCE_UM)
            squares.append(
                float(np.mean((spread.density[0, inside] - wanted) ** 2)) / float(wanted.max()) ** 2
            )
        found.append(float(np.sqrt(np.mean(squares))))
    return tuple(found)


def claim_1() -> Row:
    """Appendix C: samples approach claim 1."""
    windows = (16, 256, 1024)
    errors = speckle_errors(windows)
    slope = float(np.log(errors[-1] / errors[0]) / np.log(windows[-1] / windows[0]))
    return Row(
        "Claims 1 and 2, appendix C", "the spectrum of random steps approaches the closed form",
        "by the law of large numbers (proof, no values)",
        "rms over peak " + ", ".join(f"{one:.4f}" for one in errors) + f" for {', '.join(map(str, windows))} windows: "
        f"order N^{slope:.2f}",
        "shape", abs(slope + 0.5) < 0.1, "python -m pytest tests/sim/light/wave/test_claims.py",
        "The source must blur the lobe too, and claim 2 needs the Dirichlet kernel.",
    )  # fmt: skip


def appendix_b() -> Row:
    """Appendix B: genetic search of a dot."""
    design = designed("lobe", lobe_model(0.04, 0.04))
    assert isinstance(design.model, LobeModel)
    found = refine(
        dot_task(design, design.model, DOT_UM), np.random.default_rng(SEED), Limits(None, 2), population=2
    )
    return Row(
        "Appendix B", "genetic search for a dot of 112 µm whose spectrum is closest to the expectation",
        "better than random dots (no values)",
        f"relative error {found.start_error:.3f} of the best random dot, {found.error:.3f} after 2 generations",
        "order", found.error < 0.8 * found.start_error,
        "anisoscope design refine wide.toml --generations 2 --population 2 --out dot.npz --png dot.png",
        "Ours polishes every child besides.",
    )  # fmt: skip


PAPER = Paper(
    "levin",
    "Fabricating BRDFs at High Spatial Resolution Using Wave Optics",
    "Levin et al. 2013, ACM Trans. Graph. 32(4), 144, doi 10.1145/2461912.2461981",
    (
        fig_1, fig_2, fig_3, fig_4, fig_5, fig_6, fig_7, fig_8, fig_9, fig_10, fig_11, fig_12,
        eq_15, section_5, widest_lobe, levels, claim_1, appendix_b,
    ),
)  # fmt: skip


def slope_density(
    height_um: FloatArray,
    pixel_um: float,
    frequency: FloatArray,
    wavelength_um: float,
    window: Window,
    h_z: float = 1.0,
) -> FloatArray:
    """The geometric limit, every point of the surface a mirror of its own slope: density of the slopes over ω, in µm.

    A facet of slope s shines at ω = −2h_z·s/λ; blurred by the same window, this is what the blurred power spectrum
    approaches as structures grow against the coherence length (Levin et al. 2013, Fig. 2).

    Args:
        height_um: (N,) heights; the slope of every stretch between two of them counts once.
        pixel_um: distance of the points in µm.
        frequency: (F,) rising, evenly spaced frequencies in cycles per µm; slopes beyond them are left out.
        wavelength_um: of the light.
        window: what blurs; some blur along x is needed.
        h_z: z component of h.

    Raises:
        ModelError: nothing blurs; the density would be a comb of infinite lines.
    """
    reach = window.half_width(wavelength_um, h_z)[0]
    if reach <= 0.0:
        raise ModelError(
            "mirrors under a point source shine in single directions: give source or aperture a size"
        )
    mirrored = -2.0 * h_z / wavelength_um * np.diff(height_um) / pixel_um
    spacing = float(frequency[1] - frequency[0])
    share, _ = np.histogram(mirrored, np.append(frequency - 0.5 * spacing, frequency[-1] + 0.5 * spacing))
    lags = np.asarray(np.fft.fftfreq(2 * frequency.size, spacing), dtype=np.float64)
    coherence = window.coherence(lags, np.zeros(1), wavelength_um, h_z)
    found = np.fft.ifft(np.fft.fft(share, 2 * frequency.size) * coherence)[: frequency.size]
    return np.asarray(found.real / (mirrored.size * spacing))
