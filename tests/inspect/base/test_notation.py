"""One notation of contrasts, probabilities and minus signs."""

import pytest

from anisoscope.base.notation import (
    contrast_name,
    number_name,
    number_text,
    p_value_text,
    percent_text,
    present_notation,
    true_minus,
)


def test_a_contrast_always_names_its_tilt():
    assert contrast_name(0.0, 90.0, 0.0) == "0° / 90°, tilt 0°"
    assert contrast_name(90.0, 180.0, -10.0) == "90° / 180°, tilt -10°"


def test_numbers_of_the_history_are_called_as_in_the_report():
    assert number_name("ln 0-90") == "ln ratio 0° / 90°, tilt 0°"
    assert number_name("difference 90-180 @-10") == "difference [1/sr] 90° / 180°, tilt -10°"
    assert number_name("ln A/B at 90") == "ln ratio A / B at 90°, tilt 0°"
    assert number_name("ln A 0-90 @10") == "ln ratio of A 0° / 90°, tilt 10°"
    assert [number_name(one) for one in ("p", "print alpha x")] == [
        "p of the squared distance",
        "print alpha x",
    ]
    assert [number_text("p", 3.9e-11), number_text("d2", 3.9e-11)] == ["< 1e-9", "3.9e-11"]


def test_probabilities_are_never_more_exact_than_their_model():
    assert (p_value_text(0.0123), p_value_text(1.9e-14), p_value_text(0.0)) == ("= 0.012", "< 1e-9", "< 1e-9")
    assert [percent_text(p) for p in (0.99999, 0.527, 0.0)] == ["> 99.9 %", "52.7 %", "< 0.1 %"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("off by -0.3 (-0.4 to -0.2)", "off by −0.3 (−0.4 to −0.2)"),
        ("tilt -10°", "tilt −10°"),
        (
            "inspected 2026-03-04, ISO 14253-1, ridge-angle, 0-90",
            "inspected 2026-03-04, ISO 14253-1, ridge-angle, 0-90",
        ),
    ],
)
def test_pages_have_true_minus_signs_and_hyphens_stay(text, shown):
    assert true_minus(text) == shown


def test_texts_of_earlier_versions_read_as_those_of_today():
    both = "of 0°/90° at tilt 0°, 90°/180° at tilt 0°, and more"
    assert present_notation(both) == "of 0° / 90°, tilt 0°; 90° / 180°, tilt 0°, and more"
    then = "ln ratio 0°/90° at tilt -3° deviates by -0.1; p = 4.1e-11, p = 1e-05, p < 1e-300"
    assert (
        present_notation(then)
        == "ln ratio 0° / 90°, tilt -3° deviates by -0.1; p < 1e-9, p = 1e-05, p < 1e-9"
    )
    assert present_notation(present_notation(then)) == present_notation(then)
    assert (
        present_notation("burrs; or, not to be told apart: wear")
        == "burrs; cannot be distinguished from: wear"
    )
