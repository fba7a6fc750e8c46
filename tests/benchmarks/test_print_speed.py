"""A picture of a printed sheet by table, against every wavelength at every point in numpy."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.sim.bench.printpart import DentPart, PrintPart
from anisoscope.sim.bench.prints import PrintSample
from anisoscope.sim.light.colour.lamps import synthetic_white_led
from anisoscope.sim.light.colour.vision import Vision, synthetic_bayer
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.ink.model import brdf

pytestmark = pytest.mark.benchmark

ROWS = 1000
PLAIN_ROWS = 20


def test_a_sheet_of_a_million_points_against_the_sum_over_wavelengths(bench):
    vision = Vision(synthetic_white_led(), synthetic_bayer())
    part = PrintPart(
        raster_um=2.0, curl_deg=1.0, grain_share=0.0, dents=(DentPart(diameter_mm=0.5, tilt_deg=2.0),)
    )
    sheet = PrintSample(part, 2e-3 * (ROWS - 1), 2.0, vision, np.random.default_rng(1))
    to_light, to_camera = (way[0] for way in directions((Pose(30.0, 10.0),), Convention()))

    def plain():
        ink, z = sheet.inks[0], sheet._normal[:PLAIN_ROWS].astype(float)
        x = np.array([1.0, 0.0, 0.0]) - z[..., :1] * z
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        light, camera = (
            np.stack([x @ way, np.cross(z, x) @ way, z @ way], axis=-1) for way in (to_light, to_camera)
        )
        return light[..., 2:] * (brdf(ink, light, camera) @ vision.weights(ink.nm))

    found = bench.compare(
        f"{ROWS} × {ROWS} points, 3 channels; 41 wavelengths only {PLAIN_ROWS} rows",
        {"table": lambda: sheet.radiance(to_light, to_camera), "41 wavelengths": plain},
    )
    pictured = found["table"].result
    assert pictured.shape == (3, ROWS, ROWS)
    np.testing.assert_allclose(
        np.moveaxis(pictured[:, :PLAIN_ROWS], 0, -1), found["41 wavelengths"].result, rtol=1e-4
    )
    ratio = found.wall_ratio("41 wavelengths", "table") * ROWS / PLAIN_ROWS
    bench.note(f"41 wavelengths for all rows take {ratio:.0f} times as long")
    assert ratio > 10.0
