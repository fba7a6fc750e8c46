"""Signed inspections: whoever rewrites a folder and the history without the key of the station is found out."""

import base64
import hashlib
import json
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from anisoscope import cli
from anisoscope.base import signature
from anisoscope.base.signature import Trust, TrustedKey, make_key, signed
from anisoscope.history.adding import add_folders
from anisoscope.history.heads import sign_head, verify_heads
from anisoscope.history.store import open_history
from anisoscope.inspection.integrity import listed_files, verify
from anisoscope.record.schema import SIGNATURE_NAME, read_record, sha256_of, write_record
from anisoscope.rig.frame import header_of, read_frame, write_frame

SCRIPT = Path(__file__).parents[3] / "docs" / "verify_bundle.py"


@pytest.fixture(scope="module")
def station(tmp_path_factory, virtual_rigs):
    """A station with a key: a good part and a failed one, both signed, in a history with a signed head."""
    root = tmp_path_factory.mktemp("station")
    with pytest.MonkeyPatch.context() as patch:
        key = make_key(root / "rig.pem")
        patch.setenv(signature.VARIABLE, str(root / "rig.pem"))
        rig = virtual_rigs()
        good = rig.inspect("GOOD-1").folder
        shutil.copytree(rig.out, root / "out")
        good = root / "out" / good.name
        failed(good, root / "out" / "BAD-1")
        with open_history(root / "out") as history:
            add_folders(history, [root / "out"])
            sign_head(history, key)
    public = base64.b64encode(key.public).decode()
    (root / "keys.toml").write_text(f'schema = 1\n[[keys]]\nstation = "rig 1"\npublic = "{public}"\n')
    return root


def failed(good, folder):
    """The folder of a part that failed, as the station writes it: with its own frames, record and signature."""
    shutil.copytree(good, folder, ignore=shutil.ignore_patterns("report*", "record*"))
    record = read_record(good)
    frames = []
    for frame in record.frames:
        path = folder / frame.name
        if frame.kind == "sample":
            write_frame(replace(read_frame(path), serial="BAD-1"), path)
        frames.append(frame.model_copy(update={"sha256": sha256_of(path)}))
    changes = {
        "serial": "BAD-1",
        "verdict": "FAIL",
        "frames": tuple(frames),
        "files": listed_files(folder, {}),
    }
    write_record(record.model_copy(update=changes), folder)


@pytest.fixture
def copy(station, tmp_path):
    """A copy of the station's folder, to be tampered with."""
    return Path(shutil.copytree(station, tmp_path / "copy"))


@pytest.fixture
def trust(station):
    return signature.read_trust(station / "keys.toml")


def folders(root):
    good, bad = (next((root / "out").glob(name)) for name in ("GOOD-1*", "BAD-1*"))
    return good, bad


def test_what_a_station_wrote_is_signed_with_serial_and_lot_in_every_frame(station, trust):
    for folder in folders(station):
        found = verify(folder, trust)
        assert (found.intact, found.distrust) == (True, ())
        assert found.signed_by.startswith("rig 1 (ed25519:")
        record = read_record(folder)
        assert SIGNATURE_NAME not in {file.name for file in record.files}
        headers = [header_of(folder / frame.name) for frame in record.frames if frame.kind == "sample"]
        assert {header.serial for header in headers} == {record.serial}
    with open_history(station / "out", create=False) as history:
        assert verify_heads(history, trust).problems == ()
        assert verify_heads(history, trust).covered == 2


def reseal(folder, **changes):
    """Rewrite a record as anybody can: with another content and the right seal."""
    path = folder / "record.json"
    content = json.loads(path.read_text()) | changes | {"seal": "0" * 64}
    text = json.dumps(content, indent=2)
    seal = hashlib.sha256(text.encode()).hexdigest()
    path.write_text(text.replace('"seal": "' + "0" * 64, f'"seal": "{seal}'))


def forge(root, variant):
    """Make the failed part a good one: its folder from the good one's, resealed, and the history written anew."""
    good, bad = folders(root)
    content = json.loads((bad / "record.json").read_text())
    own = {path.name: path.read_bytes() for path in (bad / SIGNATURE_NAME,)}
    shutil.rmtree(bad)
    shutil.copytree(good, bad, ignore=shutil.ignore_patterns("report*"))
    changes = {"serial": "BAD-1", "created_at": content["created_at"]}
    if variant == "frames too":
        frames = json.loads((bad / "record.json").read_text())["frames"]
        for frame in frames:
            if frame["kind"] == "sample":
                write_frame(replace(read_frame(bad / frame["name"]), serial="BAD-1"), bad / frame["name"])
            frame["sha256"] = sha256_of(bad / frame["name"])
        files = [file.model_dump() for file in listed_files(bad, {})]
        changes |= {"frames": frames, "files": files}
    reseal(bad, **changes)
    if variant == "own signature":
        (bad / SIGNATURE_NAME).write_bytes(own[SIGNATURE_NAME])
    elif variant == "no signature":
        (bad / SIGNATURE_NAME).unlink()
    elif variant in {"own key", "frames too"}:
        thief = make_key(root / "thief.pem")
        statement = json.loads((bad / "record.json").read_text())
        names = ("serial", "product", "verdict", "created_at")
        said = {"record": sha256_of(bad / "record.json")} | {name: statement[name] for name in names}
        (bad / SIGNATURE_NAME).write_text(signed("record", said | {"lot": None}, thief))
    with open_history(root / "out") as history, history.reading() as connection:
        from anisoscope.history.schema import signed_heads

        heads = [dict(row) for row in connection.execute(signed_heads.select()).mappings()]
    for path in (root / "out").glob("history.sqlite*"):
        path.unlink()
    with open_history(root / "out") as history:
        add_folders(history, [root / "out"])
        assert history.verify_chain() == []
        if variant in {"own key", "frames too"}:
            sign_head(history, thief)
        elif variant != "no signature":
            with history.writing() as connection:
                connection.execute(signed_heads.insert(), heads)
    return bad


@pytest.mark.parametrize(
    "variant", ["good's signature", "own signature", "no signature", "own key", "frames too"]
)
def test_a_failed_part_that_was_rewritten_from_a_good_one_does_not_pass(copy, variant, capsys):
    """With the seals, the chain of the history and even signatures made right, as far as that goes without the key."""
    bad = forge(copy, variant)
    assert read_record(bad).verdict == "PASS"  # the forgery itself is well made
    keys = ["--trust", str(copy / "keys.toml")]
    assert cli.run(["verify", str(bad), *keys]) == 1
    said = capsys.readouterr().out
    expected = {
        "good's signature": "signature of another record",
        "own signature": "signature of another record",
        "no signature": "the record is not signed",
    }.get(variant, "is not among the trusted ones")
    assert expected in said
    assert cli.run(["history", "verify", "--history", str(copy / "out"), *keys]) == 1
    said = capsys.readouterr().out
    assert any(
        line in said
        for line in ("written anew", "no head of the history is signed", "is not among the trusted ones")
    )


def test_a_signed_frame_of_another_part_is_named(copy, monkeypatch, trust):
    """Even where the key of the station signs, frames name the part that they show."""
    _, bad = folders(copy)
    record = read_record(bad)
    monkeypatch.setenv(signature.VARIABLE, str(copy / "rig.pem"))
    (copy / "rig.pem").chmod(0o600)
    write_record(record.model_copy(update={"serial": "OTHER"}), bad)
    found = verify(bad, trust)
    assert not found.intact
    assert "shows a part of serial number BAD-1, not OTHER" in found.distrust[0]


def test_a_record_without_a_signature_is_read_and_named_so(copy, capsys):
    good, _ = folders(copy)
    (good / SIGNATURE_NAME).unlink()
    assert cli.run(["verify", str(good)]) == 0
    assert "note: the record is not signed" in capsys.readouterr().out
    assert cli.run(["verify", str(good), "--trust", str(copy / "keys.toml")]) == 1
    assert read_record(good).verdict == "PASS"


def test_a_revoked_key_counts_for_nothing(copy, capsys):
    good, _ = folders(copy)
    path = copy / "keys.toml"
    (entry,) = signature.read_trust(path).keys
    revoked = Trust(schema=1, keys=(TrustedKey(**entry.model_dump() | {"revoked": "stolen"}),))
    assert "is revoked: stolen" in verify(good, revoked).distrust[0]


def verified(bundle, *keys):
    """As a stranger does it: a Python without our package, and the script of the docs."""
    program = "import sys, runpy; sys.modules['anisoscope'] = None; runpy.run_path(sys.argv.pop(1), None, '__main__')"
    done = subprocess.run(
        [sys.executable, "-I", "-c", program, SCRIPT, bundle, *keys],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stderr == ""
    return done.returncode, done.stdout


def rewritten(bundle, changed, target):
    with zipfile.ZipFile(bundle) as source, zipfile.ZipFile(target, "w") as made:
        for name in source.namelist():
            data = changed(name, source.read(name))
            if data is not None:
                made.writestr(name, data)
    return target


def test_a_stranger_verifies_a_bundle(station, tmp_path, capsys):
    """With 200 lines at most, which use cryptography and the standard library."""
    assert len(SCRIPT.read_text().splitlines()) <= 200
    bundle = tmp_path / "good.zip"
    place = ["--history", str(station / "out")]
    assert cli.run(["export", "--bundle", str(bundle), "--serial", "GOOD-1", *place]) == 0
    (entry,) = signature.read_trust(station / "keys.toml").keys
    code, said = verified(bundle, entry.public)
    assert (code, said.count("\n")) == (0, 2)
    assert said.startswith("GOOD-1: PASS, signed 20")
    assert "report: signed" in said
    thief = base64.b64encode(make_key(tmp_path / "thief.pem").public).decode()
    assert verified(bundle, thief)[0] == 1

    def change(wanted, old, new):
        return lambda name, data: data.replace(old, new) if wanted in name else data

    for changed in (
        change("record.json", b'"PASS"', b'"FAIL"'),
        change("record.json", b"GOOD-1", b"GOOD-2"),
        change("recipe", b"product", b"Product"),
        change(".tif", b"GOOD-1", b"GOOD-2"),
        change("history.json", b"GOOD-1", b"GOOD-2"),
        lambda name, data: None if name.endswith(".tif") else data,
        lambda name, data: None if name == SIGNATURE_NAME else data,
        lambda name, data: data[:-40] if name == SIGNATURE_NAME else data,
    ):
        code, said = verified(rewritten(bundle, changed, tmp_path / "changed.zip"), entry.public)
        assert (code, said.count("\n")) == (1, 1)
        assert said.startswith("NOT VERIFIED: ")


def test_a_bundle_that_would_prove_nothing_is_not_written(copy, tmp_path, capsys):
    good, _ = folders(copy)
    (good / SIGNATURE_NAME).unlink()
    place = ["--history", str(copy / "out")]
    assert cli.run(["export", "--bundle", str(tmp_path / "b.zip"), "--serial", "GOOD-1", *place]) == 74
    assert "its record is not signed" in capsys.readouterr().err
    assert cli.run(["export", "--bundle", str(tmp_path / "b.zip"), *place]) == 64
    assert not (tmp_path / "b.zip").exists()


def test_a_key_that_is_missing_shows_before_anything_moves(virtual_rig, monkeypatch, tmp_path):
    rig = virtual_rig()
    monkeypatch.setenv(signature.VARIABLE, str(tmp_path / "none.pem"))
    with pytest.raises(signature.ConfigError, match="anisoscope key new"):
        rig.inspect("A1")
    assert not rig.out.exists() or not list(rig.out.iterdir())


def report_hashed_anew(folder, report):
    """Another report, hashed anew as anybody can."""
    (folder / "report.html").write_text(report)
    lines = [f"{sha256_of(folder / name)}  {name}\n" for name in ("record.json", "report.html")]
    (folder / "report.sha256").write_text("".join(lines))


def test_a_report_that_was_rewritten_and_hashed_anew_is_found_out(station, tmp_path, anisoscope):
    good = next((station / "out").glob("GOOD-1*"))
    folder = tmp_path / good.name
    shutil.copytree(good, folder)
    trust = ("--trust", str(station / "keys.toml"))
    assert anisoscope("verify", str(folder), *trust, "--json").json["report_signed"] is True
    report_hashed_anew(folder, "<h1>FAIL</h1>")
    done = anisoscope("verify", str(folder), *trust)
    assert done.code == 1
    assert "signature of another report, or the report was changed" in done.out
    # without its signature the report counts for nothing, and that is said
    (folder / "report.signature.json").unlink()
    done = anisoscope("verify", str(folder), *trust)
    assert "the report is not covered by a signature" in done.out
    # nor does another key sign it
    other = make_key(tmp_path / "other.pem")
    names = (("record", "json"), ("report", "html"))
    hashes = {name: sha256_of(folder / f"{name}.{end}") for name, end in names}
    (folder / "report.signature.json").write_text(signed("report", hashes, other))
    done = anisoscope("verify", str(folder), *trust)
    assert done.code == 1
    assert "another key signed the report" in done.out
