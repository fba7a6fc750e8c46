"""spc, msa and camera on the command line."""

import hashlib
import json
import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import tomli_w

from anisoscope.calibration.record import dated, write_calibration
from anisoscope.cli import run
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history
from anisoscope.quality.readings import read_readings

RECIPE = {
    "schema": 1,
    "product": "plate",
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}},
    "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "u_tail": 0.0},
    "acquisition": {"exposure_s": 0.01},
    "region": {"size_mm": [1.0, 1.0]},
    "decision": {"tolerance": [0.5, 0.7]},
}
# AIAG, Measurement Systems Analysis, 4th edition: the bias example, which is stable
QUIET = (5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1, 6.2, 5.6, 6.0)


@pytest.fixture
def done(capsys):
    """Runs a command line in this process: exit code, output, errors."""

    def call(*arguments):
        code = run([str(one) for one in arguments])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture
def place(tmp_path):
    """A history of 80 parts of two lots, the second of which is shifted."""
    rng = np.random.default_rng(12)
    rows = []
    for k in range(80):
        off = 0.02 * rng.normal() + (0.1 if k >= 40 else 0.0)
        numbers = {
            "ln 0-90": 1.0 + off,
            "u ln 0-90": 0.01,
            "deviation ln 0-90": off,
            "tolerance ln 0-90": 0.3,
        }
        rows.append(
            NewRow(
                created_at=datetime(2026, 11, 1, tzinfo=UTC) + timedelta(minutes=k),
                serial=f"SN-{k}",
                product="plate",
                recipe="plate 0123456789ab",
                lot=f"L{k // 40}",
                verdict="PASS",
                reasons=(),
                folder=f"/parts/{k}",
                seal=hashlib.sha256(str(k).encode()).hexdigest(),
                software="anisoscope 0",
                numbers=numbers,
            )
        )
    with open_history(tmp_path / "history.sqlite") as history:
        history.append_all(rows)
    return tmp_path / "history.sqlite"


def csv_of(path, header, rows):
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def test_spc_of_a_history_says_shift_and_capability(done, place, tmp_path):
    page = tmp_path / "spc.html"
    code, out, err = done("spc", "--history", place, "--number", "ln 0-90", "--baseline", 40, "--html", page)
    assert (code, err) == (1, "")
    assert "not stable" in out
    assert "SN-4" in out
    assert "Good parts lie between 0.7 and 1.3" in out
    assert "nine values in a row" in out
    assert "Control charts: ln 0-90" in page.read_text(encoding="utf-8")


def test_spc_without_a_number_is_an_overview_and_by_lot_is_stable(done, place):
    code, out, _ = done("spc", "--history", place)
    assert code == 1
    assert "All series at a glance" in out
    assert "deviation ln 0-90" in out
    assert "u ln 0-90" not in out.replace("deviation", "")
    code, out, _ = done("spc", "--history", place, "-n", "ln 0-90", "--by", "lot", "--json")
    content = json.loads(out)
    assert [one["name"] for one in content["studies"]] == ["ln 0-90, lot L0", "ln 0-90, lot L1"]
    centers = [one["limits"]["center"] for one in content["studies"]]
    assert centers == [pytest.approx(1.0, abs=0.02), pytest.approx(1.1, abs=0.02)]
    code, out, _ = done("spc", "--history", place, "-n", "ln 0-90", "--lot", "L0", "--json")
    (study,) = json.loads(out)["studies"]
    assert (study["measured"], code) == (40, 0 if study["stable"] else 1)


def test_limits_from_a_reference_period_are_named(done, tmp_path):
    lines = [f"2026-11-{day:02d} 12:00,{1.0 + 0.1 * (day % 3) + (day > 10)}" for day in range(1, 21)]
    path = tmp_path / "values.csv"
    path.write_text("\n".join(["time,x", *lines]) + "\n")
    _, out, _ = done("spc", "--csv", path, "--period", "2026-11-01..2026-11-10", "--json")
    assert json.loads(out)["studies"][0]["limits"]["baseline"] == 10
    assert json.loads(out)["studies"][0]["limits"]["center"] == pytest.approx(1.1)
    _, out, _ = done("spc", "--csv", path, "--period", "2026-11-01..2026-11-10")
    assert "2026-11-01 to 2026-11-10" in out
    for wrong in ("2026-11-01", "..", "2026-12-01..", "yesterday..2026-13-01"):
        assert done("spc", "--csv", path, "--period", wrong)[0] == 64
    code, _, err = done("spc", "--csv", path, "--period", "2026-11-10..2026-11-01")
    assert (code, "ends before it begins" in err) == (64, True)
    assert done("spc", "--csv", path, "--period", "2026-11-01..", "--baseline", 5)[0] == 64


def test_subgroups_within_limits_of_earlier_data(done, place, tmp_path):
    """The first lot gives limits to a file; the second, which is shifted, is charted within them (phase II)."""
    limits, page = tmp_path / "limits.toml", tmp_path / "spc.html"
    chosen = ("spc", "--history", place, "-n", "ln 0-90", "--subgroup", 5)
    code, _, _ = done(*chosen, "--lot", "L0", "--limits-to", limits)
    assert "SN-0–SN-4 to SN-35–SN-39" in limits.read_text(encoding="utf-8")
    code, out, _ = done(*chosen, "--lot", "L1", "--limits-from", limits, "--html", page, "--json")
    (study,) = json.loads(out)["studies"]
    assert (code, study["chart"], study["limits"]["baseline"], len(study["points"])) == (1, "xbar-s", 0, 8)
    assert study["limits"]["center"] == pytest.approx(1.0, abs=0.02)
    assert study["points"][0]["value"] > study["points"][0]["upper"]
    assert "limits.toml" in page.read_text(encoding="utf-8")
    for wrong, word in (
        (("--limits-from", limits, "--baseline", 5), "name one of them"),
        (("--limits-from", limits, "--chart", "xbar-r"), "are of the chart xbar-s"),
        (("--limits-to", limits), "limits are not replaced"),
    ):
        code, _, err = done(*chosen, *wrong)
        assert (code, word in err, err.count("\n")) == (64, True, 1)
    code, _, err = done("spc", "--history", place, "-n", "deviation ln 0-90", "--limits-from", limits)
    assert (code, "the file of limits has ln 0-90 only" in err) == (64, True)
    limits.write_text("schema = 1\n", encoding="utf-8")
    assert done(*chosen, "--limits-from", limits)[0] == 78


def test_share_that_fails_and_deviations_of_a_history(done, place, tmp_path):
    code, _, err = done("spc", "--history", place, "--chart", "p", "--subgroup", "lot")
    assert (code, "at least 5 measured subgroups" in err) == (64, True)
    code, _, err = done("spc", "--history", place, "--chart", "p", "--subgroup", 10)
    assert (code, "parts that FAIL: the centre is 0" in err) == (64, True)
    rows = [
        (f"S{k}", "FAIL" if k % 7 == 0 else "PASS", f"2026-11-{1 + k // 10:02d} 12:00") for k in range(200)
    ]
    path = csv_of(tmp_path / "parts.csv", "serial,verdict,time,height", [(*row, 1.0) for row in rows])
    page = tmp_path / "p.html"
    code, out, _ = done("spc", "--csv", path, "--chart", "p", "--subgroup", "day", "--html", page)
    assert (code, "stable: nothing unusual among 20 subgroups" in out) == (0, True)
    assert "parts that FAIL" in page.read_text(encoding="utf-8")
    code, _, err = done(
        "spc", "--csv", path, "--chart", "p", "--subgroup", "day", "--lower", 0, "-n", "height"
    )
    assert (code, "leave --lower and --upper out" in err) == (64, True)


def test_a_recipe_file_gives_the_limits(done, place, tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(tomli_w.dumps(RECIPE))
    _, out, err = done("spc", "--history", place, "-n", "ln 0-90", "--recipe", recipe, "--json")
    assert err == ""
    (study,) = json.loads(out)["studies"]
    assert (study["capability"]["lower"], study["capability"]["upper"]) == (
        pytest.approx(0.5),
        pytest.approx(1.5),
    )
    _, out, _ = done("spc", "--history", place, "-n", "deviation ln 0-90", "--recipe", recipe, "--json")
    assert json.loads(out)["studies"][0]["capability"]["upper"] == 0.5
    recipe.write_text(tomli_w.dumps({**RECIPE, "decision": {}}))
    code, _, err = done("spc", "--history", place, "--recipe", recipe)
    assert (code, "no decision.tolerance" in err) == (64, True)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--number", "ln 9-9"), "there is no number 'ln 9-9'"),
        (("--by", "colour"), "--by takes product, recipe, lot"),
        (("--lower", "0"), "name it with --number"),
        (("--lot", "L9"), "no inspection of this kind"),
        (("--recipe", "none.toml"), "there is no file none.toml"),
        (("--limit", "3"), "at least 5 measured values"),
        (("--csv", "x.csv"), "name one of them"),
        (("-n", "ln 0-90", "--known-mean", "1"), "go together"),
    ],
)
def test_spc_refuses_in_one_line(done, place, arguments, word):
    code, out, err = done("spc", "--history", place, *arguments)
    assert (code, out, err.count("\n")) == (64, "", 1)
    assert word in err


def test_spc_of_a_csv_file(done, tmp_path):
    path = csv_of(
        tmp_path / "r.csv", "serial,cavity,height", [(f"S{k}", k % 2, v) for k, v in enumerate(QUIET)]
    )
    code, out, _ = done("spc", "--csv", path, "--lower", 5, "--upper", 7)
    assert (code, "15 readings" in out, "Cpk (short term)" in out) == (0, True, True)
    code, _, err = done("spc", "--csv", path, "--since", "today")
    assert (code, "--since and --until go with the history" in err) == (64, True)
    path.write_text(path.read_text() + "S15,1,high\n")
    code, _, err = done("spc", "--csv", path)
    assert (code, "line 17: height is not a number: 'high'" in err) == (64, True)


def test_no_history_is_one_line(done, tmp_path):
    code, _, err = done("spc", "--history", tmp_path / "none.sqlite")
    assert code >= 64
    assert "there is no history" in err
    assert not list(tmp_path.iterdir())


def test_msa_gauge_of_a_study_with_holes_and_of_a_nested_one(done, tmp_path):
    rng = np.random.default_rng(5)
    rows = [(f"P{p}", who, p + 0.1 * rng.normal()) for p in range(8) for who in "ABC" for _ in range(2)]
    page = tmp_path / "gauge.html"
    code, out, _ = done(
        "msa", "gauge", "--csv", csv_of(tmp_path / "g.csv", "part,appraiser,x", rows[:-3]), "--html", page
    )
    assert (code, "3 of 48 measurements are missing" in " ".join(out.split())) == (0, True)
    assert "45 measurements of 8 parts by 3 appraisers" in page.read_text(encoding="utf-8")
    code, out, _ = done(
        "msa",
        "gauge",
        "--csv",
        csv_of(tmp_path / "n.csv", "part,appraiser,x", rows),
        "--nested",
        "--html",
        page,
    )
    assert (code, "part (appraiser)" in out, "P0 of A" in page.read_text(encoding="utf-8")) == (
        0,
        True,
        False,
    )


def test_msa_gauge(done, tmp_path):
    rng = np.random.default_rng(5)
    rows = [(p, a, 3.0 * p + 0.1 * rng.normal()) for _ in range(3) for a in "ABC" for p in range(10)]
    path = csv_of(tmp_path / "g.csv", "part,appraiser,value", rows)
    page = tmp_path / "g.html"
    code, out, err = done("msa", "gauge", "--csv", path, "--tolerance", 20, "--html", page)
    assert (code, err) == (0, "")
    assert "good: measuring makes up" in out
    assert "Gauge R&amp;R: value" in page.read_text(encoding="utf-8")
    code, out, _ = done("msa", "gauge", "--csv", path, "--tolerance", 0.5, "--json")
    content = json.loads(out)
    assert (code, content["parts"], content["trials"]) == (1, 10, 3)
    assert content["components"]["gauge R&R"]["of_tolerance"] == pytest.approx(1.2, rel=0.3)


def test_msa_bias_and_stability(done, tmp_path):
    path = csv_of(
        tmp_path / "b.csv", "time,reference,value", [(f"d{k}", 6.0, v) for k, v in enumerate(QUIET)]
    )
    for study in ("bias", "stability"):
        page = tmp_path / f"{study}.html"
        code, out, err = done("msa", study, "--csv", path, "--html", page)
        assert (code, err) == (0, ""), out
        assert "no bias is seen" in out
        assert page.exists()
    code, out, _ = done("msa", "bias", "--csv", path, "--reference", 5.0, "--json")
    assert (code, json.loads(out)["significant"]) == (1, True)
    code, _, err = done("msa", "bias", "--csv", csv_of(tmp_path / "n.csv", "value", [(1,), (2,), (3,)]))
    assert (code, "name the known value" in err) == (64, True)


def test_msa_linearity(done, tmp_path):
    rng = np.random.default_rng(8)
    rows = [(r, r + 0.02 * r + 0.01 * rng.normal()) for r in (2.0, 4.0, 6.0) for _ in range(6)]
    path = csv_of(tmp_path / "l.csv", "reference,value", rows)
    code, out, _ = done("msa", "linearity", "--csv", path, "--html", tmp_path / "l.html")
    slope = re.search(r"not linear: the bias changes by ([+-][0-9.]+)", out)
    assert (code, float(slope[1])) == (1, pytest.approx(0.02, abs=0.005))
    code, _, err = done("msa", "linearity", "--csv", csv_of(tmp_path / "x.csv", "value", [(1,)]))
    assert (code, "needs a column 'reference'" in err) == (64, True)


def test_msa_attribute(done, tmp_path):
    rows = [
        (p, a, int(p % 2 == 0 or (p == 1 and a == "C")), p % 2 == 0, 0.1 * p)
        for p in range(12)
        for a in "ABC"
    ]
    rows = [(p, a, made, int(known), value) for p, a, made, known, value in rows for _ in range(2)]
    path, page = (
        csv_of(tmp_path / "a.csv", "part,appraiser,decision,reference,value", rows),
        tmp_path / "a.html",
    )
    code, out, err = done("msa", "attribute", "--csv", path, "--html", page)
    assert (code, err) == (1, "")
    assert "unacceptable rates: C" in out
    assert "Attribute agreement" in page.read_text(encoding="utf-8")
    code, out, _ = done("msa", "attribute", "--csv", path, "--json")
    assert json.loads(out)["appraisers"][0]["with_reference"]["kappa"]["value"] == 1.0
    for wrong in ((), ("--csv", path, "--masters", path)):
        code, _, err = done("msa", "attribute", *wrong)
        assert (code, "name the decisions" in err) == (64, True)


def test_msa_type1_and_process(done, tmp_path):
    standard = csv_of(tmp_path / "s.csv", "reference,value", [(6.0, v) for v in QUIET])
    page = tmp_path / "t.html"
    code, out, err = done("msa", "type1", "--csv", standard, "--tolerance", 20, "--html", page)
    assert (code, err, "capable: Cg" in out, page.exists()) == (0, "", True, True)
    assert done("msa", "type1", "--csv", standard, "--tolerance", 1)[0] == 1
    rng = np.random.default_rng(5)
    rows = [(p, a, 3.0 * p + 0.1 * rng.normal()) for _ in range(3) for a in "ABC" for p in range(10)]
    parts = csv_of(tmp_path / "g.csv", "part,appraiser,value", rows)
    given = ("msa", "process", "--standards", standard, "--tolerance", 20, "--u-calibration", 0.01)
    code, out, err = done(*given, "--gauge-study", parts, "--u-temperature", 0.02, "--html", page)
    assert (code, err) == (0, "")
    assert "measurement process capable: Q_MP" in out
    code, out, _ = done(*given, "--json")
    content = json.loads(out)
    assert (code, content["process"], content["system"]["components"]["CAL"]) == (0, None, 0.01)
    code, _, err = done(*given, "--u-temperature", 0.02)
    assert (code, "need measurements of parts" in err) == (64, True)


def test_pod_of_master_parts(done, tmp_path):
    rng = np.random.default_rng(3)
    sizes = rng.uniform(0.2, 5.0, 60)
    rows = [(size, int(rng.random() < size**3 / (1.0 + size**3))) for size in sizes]
    path, page = csv_of(tmp_path / "scratches.csv", "size,hit", [*rows, (0, 0)]), tmp_path / "p.html"
    code, out, err = done("research", "pod", "--csv", path, "--html", page)
    assert (code, err) == (0, "")
    assert "a90/95" in out
    assert "false calls: 0 of 1" in out
    assert "Probability of detection: scratches" in page.read_text(encoding="utf-8")
    signals = csv_of(tmp_path / "s.csv", "size,signal", [(s, s * np.exp(0.2 * rng.normal())) for s in sizes])
    code, out, _ = done("research", "pod", "--csv", signals, "--threshold", 2, "--json")
    assert (code, json.loads(out)["sizes"][0]["size"]) == (0, pytest.approx(2.0, rel=0.1))
    for wrong, word in (((), "name the parts"), (("--csv", signals), "signals need --threshold")):
        code, _, err = done("research", "pod", *wrong)
        assert (code, word in err) == (64, True)


def test_camera_of_a_record(done, tmp_path):
    values = {
        "gain": 0.2,
        "saturation": 19000.0,
        "linearity_error": 0.001,
        "snr_max": 138.0,
        "dynamic_range": 1800.0,
    }
    content = {
        "rig": "rig",
        "camera": {"model": "SIM", "serial": "1", "rows": 64, "cols": 64, "bit_depth": 12},
        "exposure_s": 1.3,
        "gain": 1.0,
        "frames": 40,
        "values": {name: {"value": value} for name, value in values.items()},
    }
    path = write_calibration(dated("linearity", content, valid_days=1.0), tmp_path / "linearity.json")
    code, out, err = done("camera", path, "--html", tmp_path / "camera.html")
    assert (code, err) == (0, "")
    assert "system gain K" in out
    assert "fit for measuring: linear within 0.10 %, 65 dB of dynamic range" in out
    assert "Camera SIM" in (tmp_path / "camera.html").read_text(encoding="utf-8")
    assert json.loads(done("camera", path, "--json")[1])["in_limits"] is True
    assert done("camera", tmp_path / "none.json")[0] == 3


MACHINE = "mould temperature,melt temperature,packing pressure,cycle time,tool shots"


@pytest.fixture
def moulded(done, tmp_path):
    """Parts and cycle data of the simulated press, whose mould gets colder from part 100 on."""
    folder = tmp_path / "press"
    drift = ("--setting", "mould temperature", "--change", -3, "--onset", 100, "--parts", 140)
    assert done("rig", "sim", "press", "--out", folder, *drift)[0] == 0
    return folder


def test_the_simulated_press_replaces_no_files(done, moulded):
    before = (moulded / "parts.csv").read_text()
    code, _, err = done("rig", "sim", "press", "--out", moulded)
    assert (code, "parts.csv exists: give another --out" in err) == (64, True), err
    assert (moulded / "parts.csv").read_text() == before


def test_a_drift_is_seen_and_named_from_a_file(done, moulded, tmp_path):
    page = tmp_path / "drift.html"
    said = done(
        "spc",
        "--csv",
        moulded / "parts.csv",
        "-n",
        "ln 0-90",
        "--drift",
        "--against",
        MACHINE,
        "--html",
        page,
    )
    assert said[0] == 1
    assert "most likely mould temperature" in said[1]
    assert "none of them" in said[1]
    text = page.read_text(encoding="utf-8")
    assert "ln 0-90 against parameters of the machine" in text
    assert text.index("most likely mould temperature") < text.index(
        "<h2>"
    )  # the first sentence is the answer
    wrong = done("spc", "--csv", moulded / "parts.csv", "-n", "ln 0-90", "--drift", "--against", "barrel")
    assert wrong[0] == 64
    assert "there is nothing named 'barrel'; there are: ridge height" in wrong[2]
    assert done("spc", "--csv", moulded / "parts.csv", "--against", "x")[0] == 64


def test_cycle_data_enter_the_history_and_spc_compares_with_them(done, moulded, tmp_path):
    readings = read_readings(moulded / "parts.csv")
    rows = [
        NewRow(
            created_at=readings.moment(k) + timedelta(minutes=20),
            serial=serial,
            product="plate",
            recipe="plate 0123456789ab",
            verdict="PASS",
            reasons=(),
            folder=f"/parts/{k}",
            seal=hashlib.sha256(serial.encode()).hexdigest(),
            software="anisoscope 0",
            numbers={"ln 0-90": readings.numbers["ln 0-90"][k]},
        )
        for k, serial in enumerate(readings.texts["serial"])
    ]
    place = tmp_path / "history.sqlite"
    with open_history(place) as history:
        history.append_all(rows)
    assert "no cycle data" in done("history", "covariates", "--history", place)[1]
    for expected in ("140 added, 0 there already", "0 added, 140 there already"):
        assert expected in done("history", "covariates", moulded / "cycles.csv", "--history", place)[1]
    listed = json.loads(done("history", "covariates", "--history", place, "--json")[1])
    assert listed["numbers"]["mould temperature"] == 140
    code, out, _ = done("spc", "--history", place, "-n", "ln 0-90", "--drift", "--json")
    (drift,) = json.loads(out)["drifts"]
    assert (code, drift["drift"], drift["driver"]) == (1, True, "mould temperature")
    assert len(drift["parameters"]) == 5
    code, out, _ = done("history", "verify", "--history", place)
    assert code == 0
    assert "head of the cycle data: " in out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,melt\nnoon,1\n", "entry 1: the time 'noon' is none"),
        ("time,serial,melt\n,,1\n", "entry 1: neither time nor serial"),
        ("time,lot,melt\n2026-11-01,L1,1\n", "the column lot holds words"),
        ("time\n2026-11-01\n", "there is no column of numbers"),
        ("time,melt\n2026-11-01,hot\n", "line 2: melt is not a number"),
    ],
)
def test_cycle_data_that_cannot_be_used_are_refused_by_name(done, tmp_path, text, says):
    path = tmp_path / "cycles.csv"
    path.write_text(text)
    code, _, err = done("history", "covariates", path, "--history", tmp_path / "h.sqlite")
    assert (code, says in err) == (64, True), err
    assert not (tmp_path / "h.sqlite").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--setting", "barrel", "--change", 1), "no 'barrel'"),
        (("--change", 1), "--setting and --change go together"),
        (("--parts", 0), "--parts and --onset are at least 1"),
    ],
)
def test_the_simulated_press_refuses_what_it_has_not(done, tmp_path, options, says):
    code, _, err = done("rig", "sim", "press", "--out", tmp_path / "press", *options)
    assert (code, says in err) == (64, True)
