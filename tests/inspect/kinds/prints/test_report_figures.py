"""Drawings of a print: maps where the region lies, arrows that do not cross, bars that end at nothing."""

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from anisoscope.kinds.prints import report
from anisoscope.kinds.prints.record import ColourRecord, QuantityRecord, SpotRecord

SIZE_MM, CENTER_MM = (1.0, 2.0), (5.0, -3.0)


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were drawn, before they become text."""
    found = []
    monkeypatch.setattr(report, "svg_uri", lambda figure: found.append(figure) or "")
    return found


def test_a_map_lies_where_its_region_does_and_numbers_its_spots(drawn):
    deviating = np.zeros((10, 20), dtype=bool)
    deviating[2:4, 15:18] = True
    spot = SpotRecord(x=5.65, y=-2.8, width=0.3, length=0.2, area_share=0.03, cells=6, delta_e=9.0)
    report.difference_map(9.0 * deviating, deviating, SIZE_MM, CENTER_MM, (spot,))
    axes = drawn[0].axes[0]
    assert axes.images[0].get_extent() == [4.0, 6.0, -3.5, -2.5]
    (edges,) = (patch for patch in axes.patches if patch.get_path().vertices.size)
    ends = axes.transData.inverted().transform(edges.get_transform().transform(edges.get_path().vertices))
    assert [*ends.min(axis=0), *ends.max(axis=0)] == pytest.approx([5.5, -2.9, 5.8, -2.7])
    (label,) = axes.texts
    assert (label.get_text(), label.xy) == ("1", pytest.approx((5.8, -2.7)))


@pytest.mark.parametrize("most_deg", [0.01, 8.0])
def test_an_arrow_is_no_longer_than_the_space_to_the_next(drawn, most_deg):
    lean = np.zeros((2, 40, 40))
    lean[0, 22, 22], lean[1, 10, 10] = most_deg, -0.5 * most_deg
    report.lean_map(lean, (1.0, 1.0), CENTER_MM)
    (arrows,) = (one for one in drawn[0].axes[0].collections if isinstance(one, Quiver))
    assert arrows.scale_units == "xy"
    space = np.diff(np.unique(arrows.X)).min()
    assert space == pytest.approx(0.1)
    longest = np.hypot(arrows.U, arrows.V).max() / arrows.scale
    assert longest <= space * 1.000001
    assert (longest < 0.1 * space) == (most_deg < 0.02)


def quantity(name, deviation, u):
    """A quantity of a print with a limit of 1."""
    return QuantityRecord(
        name=name, title=name, unit="", value=deviation, nominal=0.0, deviation=deviation, u=u, limit=1.0,
        guard=1.645 * u, conformance_probability=1.0, verdict="PASS",
    )  # fmt: skip


def test_the_bar_of_a_length_ends_at_zero_and_that_of_a_difference_does_not(drawn):
    report.quantity_chart([quantity("tilt", 0.1, 0.2), quantity("gain", 0.1, 0.2)])
    bars = [one for one in drawn[0].axes[0].collections if len(one.get_segments()) == 1]
    spans = [one.get_segments()[0][:, 0] for one in bars]
    assert spans[0] == pytest.approx([0.0, 0.492])
    assert spans[1] == pytest.approx([-0.292, 0.492])


def test_the_lobe_of_many_stage_angles_keeps_its_marks(drawn):
    """Twelve angles: each has a mark that is seen, and the legend stays in two columns."""
    ones = (1.0, 1.0, 1.0)
    colours = [
        ColourRecord(
            stage_deg=30.0 * k, tilt_deg=tilt, measured=ones, predicted=ones, wanted=ones, u=(0.01,) * 3, xyz=ones,
            xyz_predicted=ones, delta_e=0.0, u_delta_e=0.1,
        )
        for k in range(12)
        for tilt in (-10.0, 0.0, 10.0)
    ]  # fmt: skip
    report.lobe_chart(colours)
    axes = drawn[0].axes[0]
    marked = [line for line in axes.lines if line.get_marker() in report.MARKS]
    assert len(marked) == 12
    assert min(line.get_markersize() for line in marked) >= 3
    assert axes.get_legend()._ncols == 2
