"""The page of inks: curves in the colours of the inks, as long as eyes can tell them apart."""

from anisoscope.ink.appearance import show_inks
from anisoscope.report.ink_page import _charts
from anisoscope.sim.materials.inks import synthetic_ink
from anisoscope.sim.materials.spectra import find_illuminant


def test_curves_have_the_colours_of_their_inks_unless_two_look_alike():
    red, blue = (synthetic_ink(f"synthetic-{name}") for name in ("red", "blue"))
    apart, alike = (show_inks(inks, find_illuminant("d65")) for inks in ([red, blue], [red, red]))
    for chart in _charts(apart):
        assert [curve.colour for curve in chart.curves] == [one.hexes[0] for one in apart.inks]
    assert {curve.colour for chart in _charts(alike) for curve in chart.curves} == {None}
