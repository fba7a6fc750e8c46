"""``anisoscope rig snap`` and ``rig live`` on the virtual rig."""

import io
import json
import os
import pty
import re
import signal
import subprocess
import sys

import cv2
import httpx
import numpy as np
import pytest

from anisoscope.cli import run
from anisoscope.cli.rig.live import blocks
from anisoscope.rig.frame import read_frame


@pytest.fixture
def rig(virtual_rig):
    """A rig that stands at a stage reading of 0°, with a white tile, which takes no time to render."""
    return virtual_rig(bench={"sample": {"kind": "white-tile"}})


@pytest.fixture
def command(capsys):
    def go(*arguments):
        code = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return go


def snap(rig, out, *more):
    return ["rig", "snap", "-g", rig.rig, "--exposure", 0.0015, "--out", out, *more]


def test_a_picture_comes_with_all_that_is_known(command, virtual_rig, tmp_path):
    rig = virtual_rig()
    out = tmp_path / "a.tif"
    code, printed, err = command(*snap(rig, out, "--preview", "--json"))
    assert code == 0
    frame, found = read_frame(out), json.loads(printed)
    assert (frame.kind, frame.bit_depth, frame.exposure_s, frame.gain) == ("sample", 12, 0.0015, 1.0)
    assert frame.stage_deg == found["angle_deg"] == -10.0
    assert found["mean_counts"] == pytest.approx(frame.counts.mean())
    assert found["saturated_share"] == frame.saturated_share
    assert found["sharpness"] > 0.0
    preview = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert preview.shape == frame.counts.shape
    assert np.corrcoef(np.sqrt(np.maximum(frame.counts, 64.0) - 64).ravel(), preview.ravel())[0, 1] > 0.99
    assert "not homed since connected; the angle in the file is what was read" in err
    assert not rig.bench.light_on


def test_many_frames_are_averaged(command, virtual_rig, tmp_path):
    rig = virtual_rig(
        bench={"sample": {"kind": "white-tile"}, "sensor": {"read_noise_e": 60.0}}
    )  # 8 counts: the rounding does not show
    spread = []
    for frames in (1, 16):
        pair = []
        for name in "ab":
            out = tmp_path / f"{frames}{name}.tif"
            assert command(*snap(rig, out, "--light", "off", "--count", frames))[0] == 0
            assert read_frame(out).kind == "dark"
            pair.append(read_frame(out).counts.astype(float))
        spread.append(np.std(pair[0] - pair[1]))
    assert spread[1] == pytest.approx(spread[0] / 4.0, rel=0.05)


def test_a_colour_camera_gives_its_mosaic_and_a_preview_in_colour(command, virtual_rig, tmp_path):
    rig = virtual_rig(bench={"sample": {"kind": "white-tile"}, "sensor": {"filters": "gbrg"}})
    code, printed, _ = command(*snap(rig, tmp_path / "a.tif", "--preview"))
    assert (code, "raw mosaic, filters gbrg" in printed) == (0, True)
    frame = read_frame(tmp_path / "a.tif")
    assert frame.filters == "gbrg"
    green, blue, red = (frame.counts[row::2, col::2].mean() for row, col in ((0, 0), (0, 1), (1, 0)))
    assert green > red > blue
    assert cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED).shape == (*frame.counts.shape, 3)
    code, out, _ = command(*live(rig, "--count", 1, "--json"))
    assert (code, json.loads(out)["ridge_deg"]) == (0, None)
    code, printed, _ = command("rig", "status", "-g", rig.rig)
    assert (code, "colour filters gbrg" in printed) == (0, True)


@pytest.mark.parametrize("lit", [True, False])
def test_as_is_leaves_the_light_alone_and_asks_nobody(command, rig, tmp_path, lit, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    text = rig.rig.read_text()
    head, _, _ = text.partition("[light]")
    rig.rig.write_text(head + '[light]\ndriver = "manual"\n')
    rig.bench.light_on = lit
    out = tmp_path / "a.tif"
    assert command(*snap(rig, out))[0] == 69, "nobody can switch it"
    code, _, err = command(*snap(rig, out, "--light", "as-is", "--json"))
    assert (code, "switch" in err.lower()) == (0, False)
    frame = read_frame(out)
    assert frame.kind == "sample"
    assert (frame.counts.mean() > 500) == lit
    assert rig.bench.light_on == lit
    code, printed, _ = command(*live(rig, "--count", 1, "--light", "as-is", "--json"))
    assert (code, "mean" in json.loads(printed)) == (0, True)


def test_too_long_an_exposure_is_said(command, rig, tmp_path):
    code, out, err = command("rig", "snap", "-g", rig.rig, "--exposure", 1, "--out", tmp_path / "a.tif")
    assert code == 0
    assert "expose shorter" in err
    assert "saturated 0" not in out


def test_without_the_stage_no_angle_is_claimed(command, rig, tmp_path):
    rig.rig.write_text(rig.rig.read_text().replace("sim://elliptec?bench", "sim://nonesuch?bench"))
    out = tmp_path / "a.tif"
    assert command(*snap(rig, out))[0] == 69
    assert not out.exists()
    code, printed, err = command(*snap(rig, out, "--no-read-axes", "--json"))
    assert (code, err) == (0, "")
    assert json.loads(printed)["angle_deg"] is None
    assert np.isnan(read_frame(out).stage_deg)


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        (["--count", 0], "--count must lie between 1 and 10000"),
        (["--out", "a.jpg"], "name it .tif"),
        (["--exposure", 100], "exposure must lie between"),
        (["--gain", 0], "gain must lie between"),
    ],
)
def test_mistakes_leave_nothing_behind(command, rig, tmp_path, monkeypatch, more, complaint):
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.iterdir())
    arguments = snap(rig, "b.tif")
    if more[0] in arguments:
        at = arguments.index(more[0])
        arguments[at : at + 2] = more
    else:
        arguments += more
    code, _, err = command(*arguments)
    assert code in {64, 69}
    assert complaint in err.splitlines()[-1]
    assert set(tmp_path.iterdir()) == before
    assert not rig.bench.light_on


def test_files_are_not_replaced_unless_told(command, rig, tmp_path):
    (tmp_path / "a.png").write_text("precious")
    code, _, err = command(*snap(rig, tmp_path / "a.tif", "--preview"))
    assert (code, "a.png exists" in err) == (64, True)
    assert command(*snap(rig, tmp_path / "a.tif", "--preview", "--overwrite"))[0] == 0
    assert (tmp_path / "a.png").read_bytes()[1:4] == b"PNG"


def live(rig, *more):
    return ["rig", "live", "-g", rig.rig, "--exposure", 0.0015, "--fps", 100, *more]


def test_without_a_terminal_live_prints_lines(command, rig):
    code, out, _ = command(*live(rig, "--count", 3))
    lines = out.splitlines()
    assert code == 0
    assert [line.split("  ")[0] for line in lines] == ["frame 1", "frame 2", "frame 3"]
    assert "focus 100 % of best" in lines[0]
    assert "frames/s" in lines[-1]
    assert not rig.bench.light_on


def test_live_in_the_dark_knows_nothing(command, rig):
    code, out, _ = command(*live(rig, "--count", 2, "--light", "off", "--json"))
    for line in out.splitlines():
        row = json.loads(line)
        assert row["relative_focus"] is None
        assert row["ridge_deg"] is None
        assert sum(row["histogram"]) == pytest.approx(1.0)
    assert code == 0


@pytest.mark.parametrize("ending", ["q", "SIGINT", "SIGTERM"])
def test_live_in_a_terminal_ends_with_q_and_with_ctrl_c(rig, ending):
    ours, theirs = pty.openpty()
    command = [sys.executable, "-Im", "anisoscope", *(str(part) for part in live(rig))]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE) as process:
        os.close(theirs)
        shown = b""
        while b"histogram" not in shown or not re.search(rb"frame +([2-9]|\d\d)", shown):  # not all are shown
            shown += os.read(ours, 65536)
        if ending == "q":
            os.write(ours, b"q\n")
        else:
            process.send_signal(signal.Signals[ending])
        with pytest.raises(OSError, match="Input/output"):  # the terminal's other side closes at the end
            while os.read(ours, 65536):
                pass
        _, errors = process.communicate(timeout=120)
    os.close(ours)
    assert (process.returncode, errors) == (0, b"")
    assert "of the best seen" in shown.decode(errors="ignore")


def test_live_on_the_web_is_served_until_ctrl_c(rig):
    command = [sys.executable, "-Im", "anisoscope", *(str(part) for part in live(rig, "--web"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        first = process.stdout.readline()
        assert first.startswith("live picture at http://127.0.0.1:")
        address = first.split()[-1]
        with httpx.Client(base_url=address, follow_redirects=True, timeout=60) as client:
            assert "<h1>" in client.get("/").text
            answers = [client.get("/api/v1/live.jpg") for _ in range(3)]
        picture = cv2.imdecode(np.frombuffer(answers[-1].content, np.uint8), cv2.IMREAD_COLOR)
        numbers = json.loads(answers[-1].headers["X-Numbers"])
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert picture.shape == (512, 512, 3)
    assert numbers["frame"] >= 1
    assert 0.0 < numbers["mean"] < 1.0
    assert process.returncode == 0
    assert errors == "Ctrl-C ends it\n"


def test_blocks_show_small_shares():
    assert blocks((0.0, 0.001, 0.25, 1.0)) == " ▁▄█"
    assert blocks((0.0, 0.0)) == "  "


@pytest.mark.parametrize(
    "more", [["--count", 0], ["--fps", 0], ["--web", "--web-port", 99999], ["--web", "--count", 2]]
)
def test_live_options_that_make_no_sense(command, rig, more):
    code, out, err = command("rig", "live", "-g", rig.rig, "--exposure", 0.001, *more)
    assert code in {64, 69}
    assert (out, len(err.splitlines())) == ("", 1)
    assert not rig.bench.light_on


def test_status_calls_a_bent_camera_uncalibrated_until_something_knows_its_bend(command, virtual_rig):
    webcam = {"sensor": {"bit_depth": 8, "gain_e_per_dn": 110.0, "gamma": 2.2}}
    rig = virtual_rig(bench=webcam)
    assert "not linear, UNCALIBRATED: no response curve" in command("rig", "status", "-g", rig.rig)[1]
    found = json.loads(command("rig", "status", "-g", rig.rig, "--json")[1])["camera"]
    assert (found["linear"], found["uncalibrated"]) == (False, True)
    known = virtual_rig("known", bench=webcam, rig={"calibration": {"linearity": "linearity.json"}})
    found = json.loads(command("rig", "status", "-g", known.rig, "--json")[1])["camera"]
    assert (found["linear"], found["uncalibrated"]) == (False, False)
    assert "UNCALIBRATED" not in command("rig", "status", "-g", virtual_rig("usual").rig)[1]


def test_arrow_keys_turn_the_stage_while_the_picture_is_watched(rig):
    ours, theirs = pty.openpty()
    command = [sys.executable, "-Im", "anisoscope", *(str(part) for part in live(rig, "--jog", "--yes"))]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE) as process:
        os.close(theirs)
        shown = b""

        def read_until(words):
            nonlocal shown
            while words not in shown:
                shown += os.read(ours, 65536)

        read_until(b"arrows move")
        os.write(ours, b"+\x1b[C")
        read_until(b"stage 5\xc2\xb0")
        os.write(ours, b"q")
        with pytest.raises(OSError, match="Input/output"):
            while os.read(ours, 65536):
                pass
        _, errors = process.communicate(timeout=120)
    os.close(ours)
    assert process.returncode == 0
    assert b"homing" in errors


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        (("--pad", "auto"), 64, "--pad moves axes: it goes with --jog"),
        (("--jog", "--yes", "--pad", "/dev/no-pad"), 69, "game pad /dev/no-pad: No such file or directory"),
    ],
)
def test_jogging_that_cannot_be(command, rig, monkeypatch, more, code, words):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    found, _, err = command(*live(rig, *more))
    assert found == code
    assert words in err
