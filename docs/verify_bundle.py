"""Verify a bundle of an inspection without anisoscope.

    python verify_bundle.py BUNDLE.zip "STATION=PUBLIC_KEY" ["STATION=PUBLIC_KEY" ...]

PUBLIC_KEY is what `anisoscope key show` prints at the station; get it from there, not from the bundle. Needs Python and
the package cryptography. Exit code 0: the record is signed by the key of the station that it names, every file is the
one that the record names, and the row of the inspection is in the history whose end is signed. 1: what is wrong is
printed. A key without STATION= counts for any station.
"""

import base64
import hashlib
import itertools
import json
import sys
import zipfile

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

TYPE = "application/vnd.anisoscope.{}+json"


class Wrong(Exception):
    """What does not hold."""


def sha256(data):
    return hashlib.sha256(data).hexdigest()


def statement(envelope, kind, keys):
    """What an envelope (DSSE 1.0) says, signed by one of the keys, and the station of that key."""
    envelope = json.loads(envelope)
    name, payload = envelope["payloadType"], base64.b64decode(envelope["payload"])
    if name != TYPE.format(kind):
        raise Wrong(f"{name} is no signature of a {kind}")
    signed = b"DSSEv1 %d %s %d %s" % (len(name), name.encode(), len(payload), payload)
    for key in keys:
        try:
            signature = base64.b64decode(envelope["signatures"][0]["sig"])
            Ed25519PublicKey.from_public_bytes(base64.b64decode(key[-44:])).verify(signature, signed)
            return json.loads(payload), key[:-45]
        except InvalidSignature:
            continue
    raise Wrong(f"the {kind} is not signed by one of the keys")


def verify_record(files, keys):
    """The record is signed, its seal is right, and the files are those that it names."""
    content = files["record.json"]
    said, station = statement(files["record.signature.json"], "record", keys)
    if said["record"] != sha256(content):
        raise Wrong("the signature is that of another record")
    record = json.loads(content)
    before, _, after = content.rpartition(record["seal"].encode())
    if sha256(before + b"0" * 64 + after) != record["seal"]:
        raise Wrong("the record was changed after it had been sealed")
    flat = record["particulars"] | record
    for name in ("serial", "verdict", "created_at", "lot", "station", "origin", "judged_anew"):
        if name in said and (said[name] or "") != (flat.get(name) or ""):
            raise Wrong(f"{name} is {flat.get(name)} in the record and {said[name]} in its signature")
    if station and said["station"] not in (None, station):
        raise Wrong(f"the key of {station} signed for the station {said['station']}")
    for file in record["files"]:
        if file["name"] not in files:
            raise Wrong(f"{file['name']} is missing")
        if sha256(files[file["name"]]) != file["sha256"]:
            raise Wrong(f"{file['name']} was changed")
    known = {file["name"] for file in record["files"]}
    known |= {"record.json", "record.signature.json", "history.json"}
    known |= {"report.html", "report.sha256", "report.signature.json"}
    if files.keys() - known:
        raise Wrong(f"{min(files.keys() - known)} does not belong to the inspection")
    return record, said


def verify_report(files, of_record, keys):
    """What is known of the report: signed with the record, not covered by a signature, or missing."""
    if "report.html" not in files:
        return "missing"
    if "report.signature.json" not in files:
        return "not covered by a signature"
    said, _ = statement(files["report.signature.json"], "report", keys)
    if said["public"] != of_record["public"]:
        raise Wrong("another key signed the report than the record")
    if (said["record"], said["report"]) != (sha256(files["record.json"]), sha256(files["report.html"])):
        raise Wrong("the report was changed, or belongs to another record")
    return "signed"


def verify_history(files, record, keys):
    """The row of the inspection leads to a signed head, each row holding the hash of the one before it."""
    history = json.loads(files["history.json"])
    rows, (head, _) = history["rows"], statement(history["head"], "head", keys)
    first = json.loads(rows[0])
    if first[0] != "inspection" or {"bytes": record["seal"]} not in first:
        raise Wrong("the first row is not that of the inspection")
    if (first[3], first[8], first[10]) != (
        record["serial"],
        record["particulars"]["station"],
        record["verdict"],
    ):
        raise Wrong("the row has another serial number, station or verdict than the record")
    for earlier, later in itertools.pairwise(rows):
        if json.loads(later)[-1] != {"bytes": sha256(earlier.encode())}:
            raise Wrong("a row does not follow the one before it")
    last = json.loads(rows[-1])
    if (last[1], sha256(rows[-1].encode())) != (head["inspections"], head["head"]):
        raise Wrong("the last row is not the signed head")
    return head


def main(arguments):
    if len(arguments) < 2:
        print("usage: verify_bundle.py BUNDLE.zip PUBLIC_KEY [PUBLIC_KEY ...]", file=sys.stderr)
        return 2
    path, *keys = arguments
    try:
        with zipfile.ZipFile(path) as bundle:
            names = bundle.namelist()
            files = {name: bundle.read(name) for name in names}
        if len(files) != len(names):
            raise Wrong("a file is in the bundle twice")
        record, said = verify_record(files, keys)
        report = verify_report(files, said, keys)
        head = verify_history(files, record, keys)
    except (Wrong, OSError, ValueError, KeyError, IndexError, TypeError, zipfile.BadZipFile) as problem:
        print(f"NOT VERIFIED: {path}: {type(problem).__name__}: {problem}")
        return 1
    origin = {"rig": "taken by the rig", "imported": "imported"}.get(
        record.get("origin"), "of unknown origin"
    )
    origin += f", judged anew after {record['judged_anew']}" if record.get("judged_anew") else ""
    link = (
        f"record {said['number']} of the station" if "number" in said else "not linked to the record before"
    )
    print(
        f"{record['serial']}: {record['verdict']}, signed {said['signed_at']} for the station "
        f"{said['station'] or '(not stated)'}, {link}; frames {origin}; {len(record['files'])} files unchanged; "
        f"report: {report}"
    )
    print(f"among the first {head['inspections']} inspections of a history signed {head['signed_at']}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
