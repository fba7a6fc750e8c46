"""Evidence of an installation: known values that can fail, forgeries that are found, and a page that is signed."""

import json
from datetime import UTC, datetime

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.base.signature import Trust, TrustedKey, make_key, use_key
from anisoscope.history.address import HISTORY_NAME
from anisoscope.operations import qualification as module
from anisoscope.operations.qualification import (
    REPORT,
    RESULT,
    SIGNATURE,
    Qualification,
    code_digest,
    verified,
    write_evidence,
)
from anisoscope.operations.remembering import remember


def outcomes(lines):
    return {one.what: one.outcome for one in lines}


@pytest.fixture
def evidence(tmp_path, monkeypatch):
    """Evidence of the known values, signed; its folder and the key."""
    monkeypatch.delenv("ANISOSCOPE_SIGNING_KEY", raising=False)
    monkeypatch.setattr("anisoscope.base.signature._chosen", None)
    key = make_key(tmp_path / "station.pem")
    use_key(str(tmp_path / "station.pem"))
    lines = tuple(module._known_values())
    found = Qualification(
        "2026-03-01T08:00:00+00:00", "here", "anisoscope 0.1.0", code_digest()[0], 1.0, lines
    )
    assert "signed with ed25519:" in write_evidence(tmp_path, found)
    return tmp_path, key, found


def test_known_values_hold_and_the_page_shows_every_line(evidence):
    folder, _, found = evidence
    assert {one.outcome for one in found.lines} == {"PASS"}
    assert len(found.lines) >= 20
    page = (folder / REPORT).read_text(encoding="utf-8")
    assert page.count('<td class="PASS">PASS</td>') == len(found.lines)
    assert "approved by" in page
    assert json.loads((folder / RESULT).read_text())["result"] == "PASS"


@pytest.mark.parametrize(
    ("name", "by", "what"),
    [
        ("anisoscope.sim.light.material.fresnel", 1.01, "reflectance of a dielectric at 0°, n = 1.5"),
        (
            "anisoscope.sim.light.colour.spaces.ciede2000",
            1.01,
            "CIEDE2000 of (50.0, 2.5, 0.0) and (50.0, 0.0, -2.5)",
        ),
        (
            "anisoscope.sim.light.wave.orders.level_phases",
            1.01,
            "grating of two levels, depth λ/8: power in order 1",
        ),
        ("anisoscope.sim.light.material.brdf_table", None, "light"),
    ],
)
def test_a_program_that_computes_otherwise_fails(monkeypatch, name, by, what):
    """One per cent off, or a part that cannot be loaded."""
    from anisoscope.base.errors import ModelError

    module_name, _, function = name.rpartition(".")
    real = getattr(__import__(module_name, fromlist=[function]), function)

    def wrong(*arguments):
        if by is None:
            raise ModelError("no such kernel")
        return by * real(*arguments)

    monkeypatch.setattr(name, wrong)
    assert outcomes(module._known_values())[what] == "FAIL"


def test_what_was_changed_after_signing_is_found(evidence):
    folder, key, _ = evidence
    import base64

    trusted = TrustedKey(station="rig 1", public=base64.b64encode(key.public).decode())
    words, good = verified(folder, Trust(keys=(trusted,)))
    assert (good, words.startswith("PASS, unchanged, signed by rig 1")) == (True, True)
    words, good = verified(folder, Trust())
    assert (good, "is not among the trusted ones" in words) == (False, True)
    for name in (REPORT, RESULT):
        path = folder / name
        content = path.read_bytes()
        path.write_bytes(content.replace(b"PASS", b"FAIL", 1))
        assert verified(folder, None) == (f"changed since it was signed: {name}", False)
        path.write_bytes(content)
    path = folder / SIGNATURE
    path.write_text(path.read_text().replace('"sig": "', '"sig": "AAAA', 1))
    assert not verified(folder, None)[1]
    path.unlink()
    with pytest.raises(RecordError, match=r"signature\.json: cannot be read"):
        verified(folder, None)


def test_forgeries_of_an_inspection_and_a_history_are_found(inspected_part, monkeypatch):
    inspected = inspected_part[1]
    history = inspected.folder.parent / HISTORY_NAME
    remember(inspected, history)
    before = {path: path.read_bytes() for path in (history, *inspected.folder.rglob("*.tif"))}
    found = list(module._forgeries(inspected.folder, history))
    assert [one.outcome for one in found] == ["PASS"] * 4
    assert all(path.read_bytes() == content for path, content in before.items())
    monkeypatch.setattr("anisoscope.history.store.History.verify_chain", lambda _: [])
    assert (
        outcomes(module._forgeries(inspected.folder, history))["PASS and FAIL exchanged in a history"]
        == "FAIL"
    )


def test_versions_files_and_code_have_limits(monkeypatch):
    digest, changed, listed = code_digest()
    lines = list(module._installation(None, "0" * 64, digest, changed, listed))
    assert {one.what for one in lines if one.outcome == "FAIL"} == {"code of this program, SHA-256"}
    assert outcomes(module._installation(None, digest.upper(), digest, ("anisoscope/api.py",), 9)) | {
        "code of this program, SHA-256": "PASS",
        "installed files": "FAIL",
    } == outcomes(module._installation(None, digest, digest, ("anisoscope/api.py",), 9))
    monkeypatch.setattr("importlib.metadata.version", lambda name: "1.0" if name == "numpy" else "99.0")
    found = outcomes(module._installation(None, None, digest, (), 0))
    assert (found["package numpy"], found["package pillow"]) == ("FAIL", "PASS")


def test_a_rig_is_named_with_its_devices_calibrations_and_self_test(inspected_part):
    rig = inspected_part[0].rig
    found = list(module._rig_lines(rig, 0.006, lambda *_: None))
    named = outcomes(found)
    assert {one.part for one in found} == {"RIG"}
    assert any(what.startswith("device: ") for what in named)
    assert "misfit of the markers" in named
    assert "FAIL" not in {one.outcome for one in module._rig_lines(rig, None, lambda *_: None)}


@pytest.mark.soak
def test_the_command_qualifies_this_installation(anisoscope, tmp_path):
    began = datetime.now(UTC)
    done = anisoscope("qualify", "--out", tmp_path, "--json", timeout=900)
    assert (done.code, done.json["result"]) == (0, "PASS"), done.err
    assert done.json["duration_s"] < 900.0
    (folder,) = tmp_path.glob("qualification-*")
    assert (folder / REPORT).is_file()
    assert datetime.fromisoformat(done.json["created_at"]) >= began.replace(microsecond=0)
    assert {one["part"] for one in done.json["lines"]} == {"IQ", "OQ", "OQ-R"}


def test_wrong_options_and_folders_are_one_line(anisoscope, tmp_path):
    (tmp_path / "file").write_text("x")
    for arguments, words in (
        (("--exposure", "0.01"), "--exposure goes with --rig"),
        (("--check", tmp_path), "cannot be read: No such file"),
        (("--out", tmp_path / "file"), "cannot make the folder"),
    ):
        done = anisoscope("qualify", *arguments)
        assert done.code >= 64
        assert words in done.err
        assert len(done.err.strip().splitlines()) == 1
