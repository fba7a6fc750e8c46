"""What commands print: numbers in per cent as they are read, in tables, lines and errors; JSON is as recorded."""

import json

from anisoscope.cli.log import report
from anisoscope.cli.tables import answer, print_lines, print_table

SAID = "height loss 1.1% [95% interval], by --defect roughness=20% of part A1%20B"
READ = "height loss 1.1 % [95 % interval], by --defect roughness=20% of part A1%20B"


def test_a_number_in_per_cent_has_its_blank_wherever_it_is_printed(capsys):
    print_lines(SAID, "0.2 % of it")
    assert capsys.readouterr().out == f"{READ}\n0.2 % of it\n"
    print_lines(SAID, stderr=True)
    assert capsys.readouterr().err == f"{READ}\n"
    print_table("of 5%", ["part", "within 3%"], [["A", "12.5%"], ["B", "7%"]], caption="at 95%")
    printed = capsys.readouterr().out
    assert [one in printed for one in ("of 5 %", "within 3 %", "12.5 %", "7 %", "at 95 %")] == 5 * [True]
    report(SAID)
    assert capsys.readouterr().err == f"anisoscope: {READ}\n"


def test_json_holds_texts_as_they_were_recorded(capsys):
    answer({"reason": SAID}, (), json_=True)
    assert json.loads(capsys.readouterr().out) == {"reason": SAID}
