"""What scanners type."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.inspection.batch.scan import Scan, read_scan


@pytest.mark.parametrize(
    ("raw", "found"),
    [
        ("A17", Scan("A17", "A17")),
        (" A 17 \r\n", Scan("A 17", "A 17")),
        ("\x02A17\x03\r", Scan("A17", "A17")),
        ("]d1A17", Scan("A17", "A17")),
        ("]C0A17\t", Scan("A17", "A17")),
        ("]d210LOT7\x1d21A17", Scan("(10)LOT7(21)A17", "A17", "LOT7", gs1=True)),
        ("\x1d21A17\x1d10LOT7\x1d", Scan("(21)A17(10)LOT7", "A17", "LOT7", gs1=True)),
        ("]C121A17<GS>10LOT7", Scan("(21)A17(10)LOT7", "A17", "LOT7", gs1=True)),
        ("]Q3(10)LOT7(21)A17", Scan("(10)LOT7(21)A17", "A17", "LOT7", gs1=True)),
        ("(10)LOT7(21)A17", Scan("(10)LOT7(21)A17", "A17", "LOT7", gs1=True)),
        # a predefined length needs no separator: a GTIN, then the serial number
        (
            "]d201095060001343522112610292",
            Scan("(01)09506000134352(21)12610292", "12610292", None, gs1=True),
        ),
        ("]d21126010221A17", Scan("(11)260102(21)A17", "A17", None, gs1=True)),
        ("]d2310300175021A17", Scan("(3103)001750(21)A17", "A17", None, gs1=True)),
        ("]d2240X9\x1d10L", Scan("(240)X9(10)L", None, "L", gs1=True)),
        ("s", Scan("s", "s")),
    ],
)
def test_identifiers_and_separators_go_and_elements_are_told_apart(raw, found):
    assert read_scan(raw) == found


@pytest.mark.parametrize("raw", ["", " \r\n", "\x1d", "]d2", "\x02\x03"])
def test_nothing_was_scanned(raw):
    with pytest.raises(UsageError, match="the code is empty"):
        read_scan(raw)


@pytest.mark.parametrize("raw", ["]d2010950600", "]d2ABC", "]d221", "]d211260102\x1d21"])
def test_a_broken_element_string_is_no_serial_number(raw):
    with pytest.raises(UsageError, match="is cut off or no GS1"):
        read_scan(raw)
