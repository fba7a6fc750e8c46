import pytest
import tomli_w

from anisoscope.base.errors import RigFileError
from anisoscope.sim.bench.benchfile import read_bench


def read(tmp_path, tables, schema=1):
    path = tmp_path / "bench.toml"
    path.write_text(tomli_w.dumps({"schema": schema, **tables}), encoding="utf-8")
    return read_bench(path)


MISTAKES = {
    "sample.pitch_mm: unknown key; did you mean 'pitch_um'?": {"sample": {"pitch_mm": 0.1}},
    "sample.kind": {"sample": {"kind": "mirror"}},
    "sample.file": {"sample": {"kind": "height-map"}},
    "sample.burr_coverage": {"sample": {"burr_coverage": 1.2}},
    "sample.material.index": {"sample": {"material": {"index": 1.0}}},
    "sensor.rows": {"sensor": {"rows": 10}},
    "sensor.bit_depth": {"sensor": {"bit_depth": 12.5}},
    "sensor.read_noise_e": {"sensor": {"read_noise_e": -1.0}},
    "sensor.gain_e_per_dn": {"sensor": {"gain_e_per_dn": float("nan")}},
    "optics.pixel_um": {"optics": {"pixel_um": "4 um"}},
    "optics.axis_px[1]": {"optics": {"axis_px": [1.0]}},
    "optics.lens_cap": {"optics": {"lens_cap": 1}},
    "stage: 'G' is not an Elliptec address": {"stage": {"address": "G"}},
    "stage.turns": {"stage": {"turns": "left"}},
    "stage: there is no fault 'stal'": {"stage": {"faults": ["stal:30"]}},
    "stage: fault stall: 'x' is not a number": {"stage": {"faults": ["stall:x"]}},
    "fixture.marker_mm": {"fixture": {"markers": [{"id": 0, "x_mm": 0.0, "y_mm": 0.0}]}},
    "fixture: marker 1 is listed twice": {
        "fixture": {"marker_mm": 1.0, "markers": [{"id": 1, "x_mm": float(x), "y_mm": 0.0} for x in (0, 1)]}
    },
    "lamp: unknown key": {"lamp": {"drift": 0.1}},
    "sample: there is a table [sample.print], but the kind is 'ridges': set kind = \"print\"": {
        "sample": {"print": {"coverage": 0.5}}
    },
    "sample: there is a table [sample.wafer], but the kind is 'ridges': set kind = \"wafer\"": {
        "sample": {"wafer": {"file": "tile.npz"}}
    },
    "sample.print.substrate: input should be less than or equal to 1, not 1.5": {
        "sample": {"kind": "print", "print": {"substrate": 1.5}}
    },
    "sample.print.wrong_share: input should be less than or equal to 1, not 5": {
        "sample": {"kind": "print", "print": {"wrong_share": 5}}
    },
    "sample.print: wrong_share needs to know which ink it is": {
        "sample": {"kind": "print", "print": {"wrong_share": 0.05}}
    },
    "sample.print.ink: no ink is named 'synthetic-pink'; known: synthetic-red, synthetic-green": {
        "sample": {"kind": "print", "print": {"ink": "synthetic-pink"}}
    },
    "none.toml: there is no such file": {"sample": {"kind": "print", "print": {"ink": "none.toml"}}},
    "sample.print.wrong_ink: no ink is named 'pink'": {
        "sample": {"kind": "print", "print": {"wrong_ink": "pink", "wrong_share": 0.05}}
    },
    "sample.print: alpha must lie above 0 and at most at 1, not 1.8": {
        "sample": {"kind": "print", "print": {"alpha": 0.9, "alpha_share": 1.0}}
    },
    "sample.print.substrate": {"sample": {"kind": "print", "print": {"substrate": "none.csv"}}},
    "optics.spectrum: no illuminant is named 'd99'": {
        "sample": {"kind": "print"},
        "optics": {"spectrum": "d99"},
    },
    "sensor.sensitivities: no sensitivities are named 'eye'": {
        "sample": {"kind": "print"},
        "sensor": {"filters": "rggb", "sensitivities": "eye"},
    },
}


@pytest.mark.parametrize("message", MISTAKES)
def test_mistakes_are_one_line_that_names_file_and_key(tmp_path, message):
    with pytest.raises(RigFileError) as caught:
        read(tmp_path, MISTAKES[message])
    text = str(caught.value)
    assert message in text
    assert str(tmp_path / "bench.toml") in text
    assert "\n" not in text
    assert " more)" not in text


def test_another_schema_is_refused(tmp_path):
    with pytest.raises(RigFileError, match="schema"):
        read(tmp_path, {}, schema=2)


def test_here_is_the_folder_of_the_file(tmp_path):
    file = read(tmp_path, {"sample": {"kind": "height-map", "file": "${here}/map.x3p"}})
    assert file.sample.file == tmp_path / "map.x3p"
