"""Numbers as people write them."""

import pytest

from anisoscope.base.quantity import Likely, read_number, unit_of

PITCH = Likely(0.5, 5000.0, "ridges")


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("10", "um", 10.0),
        ("10.5", "um", 10.5),
        ("10,5", "um", 10.5),
        ("-1e-3", "", -0.001),
        ("−2", "deg", -2.0),
        ("0.1 mm", "um", 100.0),
        ("0,1mm", "um", 100.0),
        ("250 nm", "um", 0.25),
        ("100um", "um", 100.0),
        ("100 µm", "um", 100.0),
        ("10°", "deg", 10.0),
        ("0.1 rad", "deg", 5.729577951308232),
        ("5 %", "share", 0.05),
        ("20 ms", "s", 0.02),
        ("0.55 µm", "nm", 550.0),
    ],
)
def test_numbers_with_and_without_units(text, unit, value):
    assert read_number(text, "--option", unit) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("x", "um", "--option takes a number of µm, not 'x'"),
        ("1.5.2", "", "--option takes a number, not '1.5.2'"),
        ("", "deg", "--option takes a number of °, not ''"),
        ("3 kg", "um", "--option 3 kg: 'kg' is no unit of it; it takes nm, um, µm, μm, mm, cm"),
        ("3 mm", "", "--option 3 mm: 'mm' is no unit of it; leave it out"),
        ("nan", "um", "--option takes a number of µm, not 'nan'"),
    ],
)
def test_what_is_no_number_is_named(text, unit, words):
    with pytest.raises(ValueError, match=r".") as problem:
        read_number(text, "--option", unit)
    assert str(problem.value) == words


def test_an_unlikely_pitch_asks_whether_mm_were_meant():
    with pytest.raises(ValueError, match=r".") as problem:
        read_number("0.1", "--pitch", "um", PITCH)
    assert str(problem.value) == (
        "--pitch 0.1 µm? ridges of 0.1 mm are --pitch 100 (or write 0.1mm); if 0.1 µm is meant, write 0.1um"
    )
    assert read_number("0.1um", "--pitch", "um", PITCH) == 0.1
    assert read_number("60", "--pitch", "um", PITCH) == 60.0


@pytest.mark.parametrize(
    ("written", "unit", "read"),
    [
        ("40000", "um", "of 40000 nm are flake_um 40 (or write 40000nm); flakes have 0.5 to 1000 µm"),
        ("0.04", "um", "of 0.04 mm are flake_um 40 (or write 0.04mm); flakes have 0.5 to 1000 µm"),
        ("1e9", "um", "flakes have 0.5 to 1000 µm: check the number and its unit"),
        ("1e9um", "um", "flakes have 0.5 to 1000 µm: check the number and its unit"),
        ("0.4", "nm", "of 0.4 µm are flake_um 400 (or write 0.4um); flakes have 0.5 to 1000 nm"),
        ("2000", "mm", "of 2000 µm are flake_um 2 (or write 2000um); flakes have 0.5 to 1000 mm"),
    ],
)
def test_a_firm_range_asks_for_the_unit_or_gives_its_ends(written, unit, read):
    firm = Likely(0.5, 1000.0, "flakes", firm=True)
    with pytest.raises(ValueError, match=r"^flake_um .*\? .") as problem:
        read_number(written, "flake_um", unit, firm)
    assert str(problem.value).endswith(read)
    for value in ("0.5", "1000", "40 µm" if unit == "um" else "40"):
        assert firm.low <= read_number(value, "flake_um", unit, firm) <= firm.high


def test_a_pitch_in_nm_is_asked_about_and_with_its_unit_taken():
    with pytest.raises(ValueError, match=r"ridges of 100000 nm are --pitch 100 \(or write 100000nm\); if"):
        read_number("100000", "--pitch", "um", PITCH)
    assert read_number("100000um", "--pitch", "um", PITCH) == 1e5
    assert read_number("100000nm", "--pitch", "um", PITCH) == pytest.approx(100.0)


def test_units_are_the_ends_of_names():
    assert [unit_of(name) for name in ("pitch_um", "light_angle_deg", "alpha_share", "albedo", "tail")] == [
        *("um", "deg", "share", "", "")
    ]
