"""Results as tables, pictures and data frames."""

import sys

import pytest

from anisoscope.api import control_chart, make_surface, predict
from anisoscope.base.errors import UsageError
from anisoscope.base.notebook import MOST_ROWS, data_frame, html_table
from anisoscope.parameters.ridges import RidgeDesign


def test_what_a_file_or_an_operator_wrote_is_escaped():
    assert "<script>" not in html_table("<script>", ("<script>",), [("<script>",)])
    assert "<script>" not in control_chart([1.0, 1.1, 0.9] * 4, name="<script>")._repr_html_()
    surface = make_surface("ridges", size_um=(20, 200), pixel_um=(2.0, 2.0))
    assert "<script>" not in surface.with_height(surface.height_um, file='"><script>')._repr_html_()


def test_a_long_table_is_cut():
    table = html_table("numbers", ("n",), [(n,) for n in range(MOST_ROWS + 7)])
    assert table.count("<tr>") == MOST_ROWS + 1
    assert "and 7 more" in table


def test_without_pandas_one_line_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match="pip install pandas"):
        data_frame({"a": [1]})


def test_a_prediction_is_drawn_with_a_line_for_every_tilt():
    from matplotlib.figure import Figure

    found = predict(RidgeDesign(100.0, 10.0), tilts_deg=(0.0, 10.0))
    axes = found.plot(Figure().add_subplot())
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["tilt 0°", "tilt 10°"]
    assert "corrected" in found._repr_html_()
    table = found.to_frame()
    assert table.ln_to_next.isna().tolist() == [False, False, True, False, False, True]
