"""Figures and the table of Pranovich et al. 2024, on goniochromatic inks and their soft proof."""

from functools import cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.ink.fitting import InkFit, fit
from anisoscope.ink.goniometer import Readings
from anisoscope.report.study_page import Chart, Curve, chart_uri
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import ciede2000, lab
from anisoscope.sim.light.ink.model import MODELS, brdf_at_angles
from anisoscope.sim.light.ink.shading import Light
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink, with_roughness
from anisoscope.sim.proof.comparison import Comparison, compare, synthetic_readings, two_lights
from anisoscope.sim.proof.halftone import Halftone, halftone
from anisoscope.sim.proof.measured import Measured
from anisoscope.sim.proof.render import PHOTO, adaptation, direction, proof_picture, to_screen
from anisoscope.sim.proof.scene import Scene, printed, surface
from anisoscope.sim.proof.separation import separation
from anisoscope.study.papers.rows import Paper, Row, picture

SEED = 2024
NOT_HERE = "The authors' spectra are not published with the paper; the inks of this package are made up."
PRINTED = {
    "goniochromatic": ((0.1182, 0.7557), (0.1163, 0.7159), (0.0792, 0.8034)),
    "schlick": ((0.1495, 0.6096), (0.1444, 0.5978), (0.1020, 0.7329)),
}
"""Table 1: (RMSE, SSIM) of the red, green and blue ink."""


def fig_1() -> Row:
    """Photographs, micrographs and the set-up."""
    return Row(
        "Fig. 1, 2, 3", "photographs of patches, electron micrographs, drawing of the goniometer", "no values", "–",
        "none", None, "", "Pictures of samples that we do not have.",
    )  # fmt: skip


@cache
def readings_of(name: str) -> Measured:
    """Made-up readings of an ink: the paper's angles, 3 % noise, errors of the angles, a lobe toward the light."""
    rng = np.random.default_rng(SEED).spawn(len(SYNTHETIC))[SYNTHETIC.index(name)]
    return synthetic_readings(synthetic_ink(name), rng)


@cache
def fitted(name: str, method: str) -> InkFit:
    """Fit of the made-up readings by "joint" or by the paper's two steps."""
    made = readings_of(name)
    places, bands = made.value.shape
    read = Readings(
        np.repeat(made.theta_i_deg, bands), np.repeat(made.theta_o_deg, bands), np.tile(made.wavelengths_nm, places),
        made.value.ravel(), tuple(range(made.value.size)),
    )  # fmt: skip
    return fit(read, "paper" if method == "paper" else "joint")


def fig_4() -> Row:
    """Fits of three inks."""
    alphas = {method: [fitted(name, method).alpha for name in SYNTHETIC] for method in ("paper", "joint")}
    curves_rho, curves_c = [], []
    for name, colour in zip(SYNTHETIC, ("#c0392b", "#2e8b57", "#2a6db0"), strict=True):
        ink = fitted(name, "joint").ink(name, "")
        nm = np.asarray(ink.wavelengths_nm)
        curves_rho.append(Curve(ink.name, nm, np.asarray(ink.rho), colour=colour))
        curves_c.append(Curve(ink.name, nm, np.asarray(ink.c), colour=colour))
    charts = [
        (chart_uri(Chart("ρ", "wavelength [nm]", "ρ [1]", tuple(curves_rho), points=False)), "reflectance ρ"),
        (
            chart_uri(Chart("c", "wavelength [nm]", "c [1]", tuple(curves_c), points=False)),
            "goniochromatism c",
        ),
    ]
    found, joint = (", ".join(f"{one:.3f}" for one in alphas[key]) for key in ("paper", "joint"))
    return Row(
        "Fig. 4", "fit of roughness, ρ and c to readings of three inks",
        "α = 0.19 for all three, the angles of the light within 3 %",
        f"α = {found} by the published two steps, {joint} jointly, of readings that were made with α = 0.19",
        "none", None,
        "anisoscope ink fit red.csv --fit-method paper",
        f"{NOT_HERE} Our readings were made from the answer: the fits return what was put in, and say nothing on the "
        "paper's α, ρ and c.", charts,
    )  # fmt: skip


def eq_7() -> Row:
    """Eq. 7 holds in the mirror direction."""
    ink = synthetic_ink("synthetic-green")
    ratios = [
        float(np.median(brdf_at_angles(ink, angle, angle) / brdf_at_angles(ink, angle, -angle)))
        for angle in (20.0, 65.0)
    ]
    return Row(
        "Eq. 7", "the fit uses “perfect specular” readings, written ω_i = ω_o", "f(ω_i = ω_o)",
        f"holds in the mirror direction; with ω_i = ω_o Eq. 5 is {ratios[0]:.0f} (20°) to {ratios[1]:.0f} (65°) times "
        "smaller",
        "number", abs(ratios[0] - 17.0) < 1.0 and abs(ratios[1] - 526.0) < 30.0,
        "python -m pytest tests/sim/light/ink -k mirror", "A slip of notation in the paper.",
    )  # fmt: skip


@cache
def comparisons(size: int) -> tuple[Comparison, ...]:
    """Spheres of the three inks by every model, against spheres made from the readings."""
    return tuple(
        compare(readings_of(name), fitted(name, "joint").ink(name, ""), size=size, repeats=3)
        for name in SYNTHETIC
    )


def fig_5() -> Row:
    """Spheres at several roughnesses."""
    where = surface(Scene("sphere"), 128, 128)
    lights = two_lights(standard("d65"))
    pictures, shifts = [], []
    for name in SYNTHETIC:
        strip = []
        for model in ("goniochromatic", "schlick"):
            for alpha in (0.1, 0.19, 0.3):
                linear = proof_picture(
                    where, [with_roughness(synthetic_ink(name), alpha)], lights, None, model=model
                )
                strip.append(to_screen(linear, 1.0 / max(float(np.quantile(linear, 0.995)), 1e-9)))
        pictures.append(
            picture(
                np.concatenate(strip, axis=1) / 255.0, f"{name}: Eq. 5 at α 0.10, 0.19, 0.30; then Schlick"
            )
        )
        shifts.append(_hue_shift(name))
    ours, theirs = (max(pair[k] for pair in shifts) for k in (0, 1))
    return Row(
        "Fig. 5", "spheres of three inks at several roughnesses by Eq. 5 and by the standard model",
        "Eq. 5 shows another colour at grazing angles; the standard model does not",
        f"ΔE2000 from 20° to 65° in the mirror direction at equal lightness: up to {ours:.1f} by Eq. 5, "
        f"{theirs:.1f} by Schlick's",
        "order", ours > 1.5 * theirs,
        "anisoscope ink show synthetic-red synthetic-green synthetic-blue --png inks.png", NOT_HERE, pictures,
    )  # fmt: skip


def _hue_shift(name: str) -> tuple[float, float]:
    """ΔE2000 between 20° and 65° in the mirror direction, luminances made equal, by Eq. 5 and by Schlick."""
    ink = synthetic_ink(name)
    weights = xyz_weights(standard("d65"), ink.nm)
    white = np.ones(ink.nm.size) @ weights
    found = []
    for model in ("goniochromatic", "schlick"):
        low, high = (brdf_at_angles(ink, angle, angle, model) @ weights for angle in (20.0, 65.0))
        pair = [lab(0.3 * one / one[1], white) for one in (low, high)]
        found.append(float(ciede2000(*pair)))
    return found[0], found[1]


def table_1() -> Row:
    """RMSE, SSIM and frame time."""
    found = comparisons(512)
    rows = {
        model: [one.rows[MODELS.index(model)] for one in found] for model in ("goniochromatic", "schlick")
    }

    def texts(model: str) -> str:
        return ", ".join(f"{row.rmse:.4f} / {row.ssim:.4f}" for row in rows[model])

    def as_stated(model: str) -> str:
        return ", ".join(f"{rmse:.4f} / {ssim:.4f}" for rmse, ssim in PRINTED[model])

    better = all(
        one.rmse < other.rmse and one.ssim > other.ssim
        for one, other in zip(rows["goniochromatic"], rows["schlick"], strict=True)
    )
    frames = [1e6 * min(row.frame_s for row in rows[model]) for model in rows]
    return Row(
        "Table 1", "RMSE / SSIM of spheres by the models against spheres made from readings (red, green, blue)",
        f"ours {as_stated('goniochromatic')}; standard {as_stated('schlick')}; 107 and 116 µs a frame of 512² on a GPU",
        f"Eq. 5 {texts('goniochromatic')}; Schlick {texts('schlick')}; {frames[0]:.0f} and {frames[1]:.0f} µs on this "
        "processor",
        "order", better, "anisoscope ink compare --synthetic",
        f"{NOT_HERE} Only the order of the models is compared, and it agrees with the paper's; the values are not "
        "comparable, as they are of other inks." if better else
        f"{NOT_HERE} The order of the models is not the paper's; the values are not comparable, as they are of other "
        "inks.",
        [
            picture(
                np.concatenate([one.reference, *(row.srgb for row in one.rows)], axis=1)[::2, ::2],
                f"{one.ink.name}: readings, Eq. 5, Schlick, TiO₂",
            )
            for one in found
        ],
    )  # fmt: skip


def test_card(side: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """(side, side, 3) picture in 8-bit sRGB: hues around, saturation falling inward, a grey wedge below."""
    y, x = np.mgrid[-1.0 : 1.0 : side * 1j, -1.0 : 1.0 : side * 1j]
    angle, radius = np.arctan2(y, x), np.clip(np.hypot(x, y), 0.0, 1.0)
    hue = np.stack([0.5 + 0.5 * np.cos(angle - 2.0 * np.pi * k / 3.0) for k in range(3)], axis=-1)
    shown = 1.0 - radius[..., None] * (1.0 - hue)
    shown[y > 0.75] = (0.5 + 0.5 * x[y > 0.75])[:, None]
    return np.asarray(np.rint(255.0 * shown), dtype=np.uint8)


@cache
def halftoned() -> Halftone:
    """The test card as dots of the three inks."""
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    return halftone(test_card(256), separation(inks, standard("d65")))


def fig_6() -> Row:
    """Halftoning without overlaps."""
    found = halftoned()
    inks = np.stack([found.mask(number) for number in range(3)], axis=-1)
    overlap = int(np.count_nonzero(inks.sum(axis=-1) > 1))
    error = float(np.abs(found.aimed - found.printed).max())
    return Row(
        "Fig. 6", "a picture becomes dots of three inks that never overlap", "no two inks at one place",
        f"{overlap} dots with two inks; mean coverages within {error:.4f}", "number", overlap == 0 and error < 0.01,
        "anisoscope ink halftone image.png --out dots.png", "",
        [picture(test_card(256) / 255.0, "the picture"), picture(inks.astype(float), "dots of the three inks")],
    )  # fmt: skip


def fig_7() -> Row:
    """The halftone on a body under two illuminants."""
    where = surface(Scene("cylinder", yaw_deg=20.0, pitch_deg=10.0), 256, 256)
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    dots = halftoned()
    cover = np.stack([dots.mask(number) for number in range(3)], axis=-1).astype(np.float32)
    pictures, means = [], []
    for lamp in ("d65", "a"):
        light = Light(direction(120.0, 45.0), np.pi, standard(lamp))
        for model in ("goniochromatic", "schlick"):
            linear = proof_picture(where, inks, [light], printed(where, cover), model=model)
            means.append(linear[linear.sum(axis=-1) > 0].mean(axis=0))
            scale = 1.0 / max(float(np.quantile(linear, 0.99)), 1e-9)
            pictures.append(picture(to_screen(linear, scale) / 255.0, f"{lamp.upper()}, {model}"))
    red = [float(one[0] / one[2]) for one in (means[0], means[2])]
    return Row(
        "Fig. 7", "a halftone on a body under D65 and A, by both models", "renderings",
        f"red over blue of the whole {red[0]:.2f} under D65, {red[1]:.2f} under A", "order", red[1] > 1.5 * red[0],
        "anisoscope ink proof image.png --out proof.html", NOT_HERE, pictures,
    )  # fmt: skip


def fig_8() -> Row:
    """Renderings with and without highlight, scattering and second light."""
    where = surface(Scene("cylinder", yaw_deg=20.0, pitch_deg=10.0), 256, 256)
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    dots = halftoned()
    cover = np.stack([dots.mask(number) for number in range(3)], axis=-1).astype(np.float32)
    lights = [Light(direction(120.0, 45.0), np.pi, standard("d65"))]
    pictures: list[tuple[str, str]] = []
    dark: list[float] = []
    scale = 0.0
    for extras, words in ((PHOTO, "with highlight, scattering and light from behind"), (None, "without")):
        linear = proof_picture(where, inks, lights, printed(where, cover), extras=extras)
        scale = scale or 1.0 / max(float(np.quantile(linear, 0.99)), 1e-9)
        hidden = (where.normal @ np.array(lights[0].to_light) <= 0.0) & (where.normal[..., 2] > 0.0)
        dark.append(float(linear[hidden].mean()))
        shown: FloatArray = to_screen(linear, scale, adaptation(standard("d65"))) / 255.0
        pictures.append(picture(shown, words))
    return Row(
        "Fig. 8 and 9", "a photograph beside the rendering with and without highlight, scattering and second light",
        "the second light brightens the shadow (photograph and renderings)",
        f"mean radiance of the shadow {dark[0]:.2g} with, {dark[1]:.2g} without", "order", dark[0] > dark[1],
        "anisoscope ink proof image.png --photo photo.jpg --out proof.html",
        "The photograph is not here; the sizes of the extras are not printed and are ours.", pictures,
    )  # fmt: skip


PAPER = Paper(
    "pranovich",
    "Empirical BRDF Model for Goniochromatic Materials and Soft Proofing With Reflective Inks",
    "Pranovich et al. 2024, IEEE Computer Graphics and Applications, doi 10.1109/MCG.2024.3391376",
    (fig_1, fig_4, eq_7, fig_5, table_1, fig_6, fig_7, fig_8),
)
