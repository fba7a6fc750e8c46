"""The printed page holds the markers where the rig file says, in true size; the registration finds them on it."""

import io
import re

import cv2
import numpy as np
import pytest
from matplotlib.transforms import Bbox

from anisoscope.base.errors import RigFileError, UsageError
from anisoscope.cli import run
from anisoscope.commissioning.markers import (
    A4_MM,
    MM_PER_INCH,
    dots_per_module,
    fixture_for_field,
    fixture_table,
    marker_sheet,
    pdf_of,
)
from anisoscope.imaging.registration.placement import locate
from anisoscope.rig.fixture import Fixture, Marker
from anisoscope.rig.rigfile import read_rig

DPI = 2400


def scanned(figure, field_mm):
    """What a scanner sees of the field about the rotation axis: (rows, cols) from 0 to 1."""
    low = np.array([105.0, 180.0]) - field_mm / 2.0
    place = Bbox([low / MM_PER_INCH, (low + field_mm) / MM_PER_INCH])
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI, bbox_inches=place)
    shown = cv2.imdecode(np.frombuffer(file.getvalue(), np.uint8), cv2.IMREAD_GRAYSCALE)
    return shown.astype(np.float32) / np.float32(255.0)


def test_markers_stand_where_the_rig_file_says():
    fixture = fixture_for_field(4.1, 1200)
    placement = locate(scanned(marker_sheet(fixture), 4.1), fixture)
    assert placement.angle_deg == pytest.approx(0.0, abs=0.05)
    assert placement.pixel_um == pytest.approx(1000.0 * MM_PER_INCH / DPI, rel=2e-3)
    assert dots_per_module(fixture, 1200) == pytest.approx(4.0, abs=0.01)


def test_the_page_is_a4_and_the_same_every_time():
    fixture = fixture_for_field(20.0, 600)
    page = pdf_of(marker_sheet(fixture))
    box = [float(value) for value in re.search(rb"/MediaBox \[([^]]+)\]", page)[1].split()]
    assert box[2:] == pytest.approx([side / MM_PER_INCH * 72.0 for side in A4_MM], abs=0.01)
    assert pdf_of(marker_sheet(fixture)) == page


def test_markers_that_cannot_be_printed_are_refused():
    with pytest.raises(UsageError, match="plotted on film"):
        fixture_for_field(0.2, 600)
    far = tuple(Marker(id=k, x_mm=100.0 * np.cos(k), y_mm=100.0 * np.sin(k)) for k in range(4))
    with pytest.raises(UsageError, match="an A4 page holds"):
        marker_sheet(Fixture(marker_mm=5.0, markers=far))
    with pytest.raises(RigFileError, match="at least 3"):
        marker_sheet(Fixture(marker_mm=5.0, markers=far[:2]))


def test_the_table_that_it_prints_is_a_fixture(tmp_path, capsys, virtual_rig):
    page = tmp_path / "markers.pdf"
    assert run(["rig", "markers", "--pdf", str(page), "--field-mm", "4.1"]) == 0
    printed = capsys.readouterr().out
    table = printed[printed.index("[fixture]") :]
    rig = virtual_rig().rig
    text = re.sub(r"\[fixture\].*?(?=\n\[|\Z)", "", rig.read_text(), flags=re.DOTALL)
    rig.write_text(f"{text}\n{table}")
    assert fixture_table(read_rig(rig).fixture) == table
    assert run(["rig", "markers", "--pdf", str(page), "--field-mm", "4.1"]) == 64
    assert "--overwrite" in capsys.readouterr().err
    assert run(["rig", "markers", "--pdf", str(page), "-g", str(rig), "--dpi", "600", "--overwrite"]) == 0
    assert "fewer than 3" in capsys.readouterr().err
