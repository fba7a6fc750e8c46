"""Serial numbers of any script, and the folders that are named after them."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.inspection.folder import make_folder
from anisoscope.inspection.job import check_serial


@pytest.mark.parametrize(
    ("serial", "name"),
    [
        ("A-0001", "A-0001"),
        ("Prüfling 7/3", "Prüfling_7_3"),
        ("Ne\u0301e", "Née"),
        ("部品:12", "部品_12"),
        ('A*?<b>|"c"\\d', "A___b___c__d"),
        ("0..", "0.."),
    ],
)
def test_any_letters_make_a_serial_number_and_a_safe_folder(tmp_path, serial, name):
    folder = make_folder(tmp_path, check_serial(serial))
    assert folder.parent == tmp_path.resolve()
    assert folder.name.startswith(f"{name}-2")


def test_the_longest_serial_number_fits_into_a_file_name(tmp_path):
    folder = make_folder(tmp_path, check_serial("部" * 64))
    assert len(folder.name.encode()) <= 255
    assert folder.is_dir()


@pytest.mark.parametrize(
    "serial", ["", " A", "A ", "-rf", "../x", "<b>", "a\nb", "a\x00", "a\u202eb", "x" * 65]
)
def test_what_cannot_be_shown_or_typed_is_refused(serial):
    with pytest.raises(UsageError, match="letters, digits, signs or blanks"):
        check_serial(serial)
