"""Predict a folder of published height maps and compare with the reflectance that was published with each.

The folder is that of Zeng et al., "Designing and Fabricating Color BRDFs with Differentiable Wave Optics" (ACM TOG,
2025, doi 10.1145/3763275; repository color-brdfs-with-wave-optics): each ``…/hmap.exr`` (heights in µm, one unit of a
surface that repeats) has a ``scale=8_render.exr`` beside it (64 × 64 directions of the light, rows along x). Names say
``pixelsize=…`` (eight pixels of the map, µm) and ``sigma=…_blur`` (Gaussian coherence at 500 nm in µm, 2.6 where it is
missing). Nothing is fetched or kept.

A Gaussian coherence of the standard deviation σ·λ/500 nm is a lamp of the standard deviation 500 nm/(2√2·π·σ) in
direction cosines. Their factor of the angles is (1 + cos θ)²/(4·cos θ·λ²); ours (Levin et al. 2013, Eq. 23) is turned
into it. One scale is fitted a design; what is compared is the luminance of eight wavelengths. The largest direction
cosine is in no file: that of `REACHES` is taken which is nearest.

    python -Im pip install 'anisoscope[exr]'
    python tools/public_designs.py FOLDER
"""

import argparse
import re
import sys
from pathlib import Path

import numpy as np
import OpenEXR

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.prediction.angular import AngularTask, angular_reflectance
from anisoscope.profiles.files.load import read_height_map
from anisoscope.sim.light.colour.observer import matching_functions

NM = tuple(420.0 + 32.5 * (k + 0.5) for k in range(8))
REACHES = (0.25, 0.3, 0.4, 0.5)
POINTS, REPEATED = 64, 8
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
INTERPOLATED = 1, 2, 4
POINT_DEG = 1e-4
"""Lens: single directions, not means over their squares."""


def published(path: Path) -> FloatArray:
    """(64, 64) luminance, rows along y."""
    with OpenEXR.File(str(path)) as file:
        rgb = np.array(file.channels()["RGB"].pixels, dtype=np.float64)
    return np.asarray((rgb @ LUMINANCE).T)


def predicted(path: Path, pixel_um: float, sigma_um: float, reach: float) -> FloatArray:
    """The same by the angular map of ``predict --map``."""
    lamp = float(np.degrees(np.arcsin(0.5 / (2.0 * np.sqrt(2.0) * np.pi * sigma_um))))
    edge = reach * (1.0 - 1.0 / POINTS)
    task = AngularTask(NM, (0.0, 0.0), edge, POINTS, 0.0, POINT_DEG, lamp_sigma_deg=lamp)
    surface = read_height_map(
        path, pixel_um=(pixel_um, pixel_um), z_unit="um", rows="up", trust=("pixel-size",)
    )
    surface = surface.with_height(surface.height_um.T)
    for times in INTERPOLATED:  # some are steeper than their pixels resolve; the heights are smooth
        try:
            found = angular_reflectance(surface, task, interpolate=times, periodic=True)
        except HeightMapError:
            if times == INTERPOLATED[-1]:
                raise
        else:
            break
    v_x, v_y = np.meshgrid(found.v, found.v)
    upright = 0.5 * (1.0 + np.sqrt(1.0 - v_x**2 - v_y**2))
    nm, matching = matching_functions()
    seen = np.interp(NM, nm, matching[:, 1])
    return np.asarray(upright**2 * np.tensordot(seen / seen.sum(), found.brdf, axes=1))


def compared(path: Path) -> tuple[float, float, float, float, float]:
    """Pixel, coherence, reach, correlation, and rms over the rms of what was published."""
    name = str(path.parent)
    pixel, sigma = re.search(r"pixelsize=([\d.]+)", name), re.search(r"sigma=([\d.]+)_blur", name)
    if pixel is None:
        raise SystemExit(f"{path}: its folder says no pixelsize=…: give the folder of the published designs")
    pixel_um, sigma_um = float(pixel[1]) / REPEATED, float(sigma[1]) if sigma else 2.6
    wanted, rows = published(path.parent / "scale=8_render.exr"), []
    for reach in REACHES:
        found = predicted(path, pixel_um, sigma_um, reach)
        scale = float(np.sum(found * wanted) / np.sum(found**2))
        rms = float(np.sqrt(np.mean((scale * found - wanted) ** 2) / np.mean(wanted**2)))
        rows.append((rms, reach, float(np.corrcoef(found.ravel(), wanted.ravel())[0, 1])))
    rms, reach, correlation = min(rows)
    return pixel_um, sigma_um, reach, correlation, rms


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of the published designs, such as output")
    folder = parser.parse_args().folder
    paths = sorted(folder.rglob("hmap.exr"))
    if not paths:
        raise SystemExit(f"{folder}: holds no hmap.exr: give the folder of the published designs")
    write = sys.stdout.write
    write("| design | pixel [µm] | coherence [µm] | reach | correlation | rms |\n|---|---|---|---|---|---|\n")
    rms = []
    for path in paths:
        *numbers, correlation, off = compared(path)
        rms.append(off)
        cells = [str(path.parent.relative_to(folder)), *(f"{one:g}" for one in numbers)]
        write(f"| {' | '.join(cells)} | {correlation:.4f} | {off:.1%} |\n")
        sys.stdout.flush()
    within = float(np.mean(np.array(rms) <= 0.03))
    write(f"\n{len(rms)} designs: median {np.median(rms):.1%} rms, {within:.0%} within 3 %\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
