import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.materials.spectra import read_plastic_spectrum

HEAD = "wavelength_nm,index,albedo\n"


def written(tmp_path, text):
    (tmp_path / "plastic.csv").write_text(text, encoding="utf-8")
    return tmp_path / "plastic.csv"


def test_a_spectrum_is_read_with_blank_lines_and_a_mark_of_excel(tmp_path):
    found = read_plastic_spectrum(written(tmp_path, "\ufeff" + HEAD + "450, 1.51, 0.1\n\n650,1.49,3e-1\n"))
    assert found.wavelengths_nm == (450.0, 650.0)
    assert (found.index, found.albedo) == ((1.51, 1.49), (0.1, 0.3))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1: the header must read wavelength_nm,index,albedo"),
        ("nm,n,rho\n450,1.5,0.1\n", "line 1: the header"),
        (HEAD, "no wavelengths"),
        (HEAD + "450,1.5\n", "line 2: 3 values expected, 2 found"),
        (HEAD + "450,1.5,0.1\n550,glass,0.1\n", "line 3: index is not a number: 'glass'"),
        (HEAD + "450,1.5,nan\n", "line 2: albedo must be a finite number"),
        (HEAD + "650,1.5,0.1\n450,1.5,0.1\n", "positive, in nm, and rise"),
    ],
)
def test_mistakes_are_one_line_with_their_place(tmp_path, text, words):
    with pytest.raises(UsageError) as caught:
        read_plastic_spectrum(written(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text(tmp_path):
    with pytest.raises(UsageError, match="cannot read"):
        read_plastic_spectrum(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="UTF-8"):
        read_plastic_spectrum(tmp_path / "binary.csv")
