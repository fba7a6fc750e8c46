"""Turn of a texture between poses: drawn textures that were turned, lit from a side, or stand still."""

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.part_turn import LEAST_POINTS, check_follows, own_turns

SIDE = 96


def texture(seed=1, side=2 * SIDE):
    """(side, side) grain with a mean of 1."""
    grain = np.random.default_rng(seed).standard_normal((side, side)).astype(np.float32)
    return 1.0 + 0.4 * cv2.GaussianBlur(grain, (0, 0), 1.5)


def lattice(period=16):
    """(2 SIDE, 2 SIDE) one tile of grain again and again."""
    return np.tile(texture(3, period), (2 * SIDE // period, 2 * SIDE // period))


def turned(picture, turn_deg, shift=(0.0, 0.0), side=SIDE):
    """(side, side) the middle of a picture that was turned counter-clockwise as seen, and shifted."""
    rows, cols = picture.shape
    middle = ((cols - 1) / 2.0, (rows - 1) / 2.0)
    to = cv2.getRotationMatrix2D(middle, turn_deg, 1.0)
    to[:, 2] += shift
    found = cv2.warpAffine(picture, to, (cols, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    first = (rows - side) // 2
    return found[first : first + side, first : first + side]


def noisy(picture, seed, share=0.02):
    return picture * (1.0 + share * np.random.default_rng(seed).standard_normal(picture.shape))


@pytest.mark.parametrize("turn_deg", [-90.0, -30.0, -5.0, 0.0, 3.0, 12.5, 60.0])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (7.0, -4.0)])
def test_a_turn_is_measured_wherever_the_part_moved_to(turn_deg, shift):
    pictures = [noisy(turned(texture(), 0.0), 1), noisy(turned(texture(), turn_deg, shift), 2)]
    (found,) = own_turns(pictures, (0.0, 45.0), 2.0)
    assert abs((found - turn_deg + 90.0) % 180.0 - 90.0) <= 1.0


def test_light_from_one_side_is_no_turn():
    """Shading is the slope towards the lamp, which stands elsewhere in the part's own frame at every pose."""
    relief, pictures, stages = texture(), [], (0.0, 90.0, 180.0)
    for number, stage_deg in enumerate(stages):
        down, across = np.gradient(relief)
        lamp = np.radians(stage_deg)
        lit = 1.0 + 1.0 * (np.cos(lamp) * across + np.sin(lamp) * down) + 0.3 * (relief - 1.0)
        pictures.append(noisy(turned(lit.astype(np.float32), 0.0), number))
    assert all(turn is None or abs(turn) <= 1.0 for turn in own_turns(pictures, stages, 2.0))


def test_a_lattice_is_known_but_for_its_symmetry():
    first = noisy(turned(lattice(), 0.0), 1)
    for turn_deg in (0.0, 5.0, 30.0):
        (found,) = own_turns([first, noisy(turned(lattice(), turn_deg), 2)], (0.0, 45.0), 2.0)
        assert abs((found - turn_deg + 45.0) % 90.0 - 45.0) <= 1.0
    assert check_follows([first, noisy(turned(lattice(), 90.0), 2)], (0.0, 45.0), 2.0) == ()


def test_noise_and_what_stands_still_in_the_picture_say_nothing():
    even = np.ones((SIDE, SIDE), np.float32)
    noise = [noisy(even, seed) for seed in range(20)]
    assert set(own_turns(noise, np.linspace(0.0, 190.0, 20), 2.0)) == {None}
    still = [turned(texture(), 0.0), turned(texture(), -90.0)]  # on the raster of a part that turned by 90°
    assert own_turns(still, (0.0, 90.0), 2.0) == (None,)
    (note,) = check_follows(still, (0.0, 90.0), 2.0)
    assert note.startswith("not watched: whether the part follows its fixture at 90° (")
    small = [picture[: LEAST_POINTS - 1] for picture in still]
    assert own_turns(small, (0.0, 90.0), 2.0) == (None,)


def test_a_part_that_slips_is_named_with_its_turn():
    pictures = [noisy(turned(texture(), 0.0), 1), noisy(turned(texture(), 5.0), 2)]
    with pytest.raises(
        MeasurementError, match=r"between 0° and 90° the part turned by \+5\.0° on its fixture"
    ):
        check_follows(pictures, (0.0, 90.0), 2.0)
