"""The demo with prints, from the command line."""

import pytest

from anisoscope.operations.demo.prints import PARTS


@pytest.mark.soak
def test_every_print_of_the_demo_gets_the_verdict_that_is_expected(anisoscope_afresh, tmp_path):
    done = anisoscope_afresh("demo", "--kind", "print", "--out", tmp_path / "demo", "--seed", 3, "--json")
    assert done.code == 0, done.out + done.err
    found = {part["serial"]: part["verdict"] for part in done.json["parts"]}
    assert found == {f"DEMO-{name}": verdict for name, verdict in PARTS.items()}
