"""Histories in SQLite and in PostgreSQL, made-up rows, and folders with real records."""

import subprocess
from datetime import UTC, datetime, timedelta
from hashlib import sha256

import pytest
from sqlalchemy import create_engine, text

from anisoscope.history.address import parse_address
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history
from anisoscope.record.schema import Record, upgraded, write_record

START = datetime(2026, 11, 1, 6, 0, tzinfo=UTC)
PRODUCT = "ridged plate"
NUMBERS = {
    "ln 0-90": 2.1,
    "u ln 0-90": 0.05,
    "deviation ln 0-90": -0.02,
    "tolerance ln 0-90": 0.25,
    "d2": 1.2,
    "p": 0.55,
    "area share": 0.001,
}


def new_row(number, **changes):
    """The made-up inspection with a number; every one has a seal of its own."""
    values = {
        "created_at": START + timedelta(minutes=number),
        "serial": f"A{number}",
        "product": PRODUCT,
        "recipe": f"{PRODUCT} 0123456789ab",
        "lot": f"L{number % 3}",
        "cavity": str(number % 4),
        "station": "east",
        "operator": "M. M.",
        "verdict": ("PASS", "PASS", "FAIL", "INCONCLUSIVE", "INVALID")[number % 5],
        "reasons": ("all is well", "indeed"),
        "folder": f"/inspections/A{number}",
        "seal": sha256(str(number).encode()).hexdigest(),
        "software": "anisoscope 0.1.0",
        "numbers": NUMBERS | {"ln 0-90": 2.0 + 0.001 * number},
    }
    return NewRow(**(values | changes))


@pytest.fixture(name="new_row")
def new_row_fixture():
    return new_row


@pytest.fixture
def sqlite_place(tmp_path):
    return str(tmp_path / "history.sqlite")


@pytest.fixture(scope="session")
def postgresql_database(postgresql_programs, postgresql_server):
    """The URL of a database of ours on a server of PostgreSQL."""
    with postgresql_programs.database(postgresql_server) as url:
        yield url


@pytest.fixture
def postgresql_place(postgresql_database):
    """The same, empty."""
    engine = create_engine(parse_address(postgresql_database).url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return postgresql_database


@pytest.fixture(params=["sqlite", "postgresql"])
def place(request):
    """Where a history may be: each test runs once for either."""
    return request.getfixturevalue(f"{request.param}_place")


@pytest.fixture
def history(place):
    with open_history(place) as found:
        yield found


@pytest.fixture
def sqlite_history(sqlite_place):
    with open_history(sqlite_place) as found:
        yield found


def contrast(**changes):
    values = {
        "from_deg": 0.0,
        "to_deg": 90.0,
        "tilt_deg": 0.0,
        "kind": "log_ratio",
        "measured": 2.1,
        "predicted": 2.0,
        "u": 0.05,
        "tolerance": 0.25,
        "guard": 0.08,
        "conformance_probability": 0.99,
        "verdict": "PASS",
    }
    return values | changes


def record_of(serial="A1", **changes):
    """A record with little in it."""
    values = {
        "schema": 1,
        "software": "anisoscope 0.1.0",
        "created_at": "2026-11-01T06:00:00+00:00",
        "serial": serial,
        "particulars": {"lot": "L1", "cavity": "3", "station": None, "operator": "M. M."},
        "product": PRODUCT,
        "verdict": "PASS",
        "reasons": ("ln ratio 0°/90° at tilt 0° deviates by +0.100",),
        "model": "ridges",
        "convention": {"light": 10.0},
        "poses": (),
        "contrasts": (contrast(),),
        "d2": 4.0,
        "dof": 1,
        "p_value": 0.05,
        "area": None,
        "budget": (),
        "drift": None,
        "white_reference": {"sha256": "aa"},
        "recipe": {"product": PRODUCT, "decision": {"tolerance": 0.25}},
        "rig": {"name": "rig", "poses": [0, 90]},
        "camera": "camera",
        "stage": "stage",
        "inputs": ({"name": "inputs/recipe.toml", "sha256": "5eed" * 16},),
        "frames": (),
    }
    return Record.model_validate(upgraded(values | changes))


@pytest.fixture
def inspected(tmp_path):
    """``inspected("A1", verdict="FAIL", name="folder")`` writes the folder of a finished inspection."""

    def write(serial="A1", *, name=None, **changes):
        folder = tmp_path / "inspections" / (name or serial)
        folder.mkdir(parents=True)
        write_record(record_of(serial, **changes), folder)
        return folder

    return write


@pytest.fixture(name="record_of", scope="session")
def record_of_fixture():
    return record_of


CONFIG = """
[req]
distinguished_name = dn
[dn]
[ca]
basicConstraints = critical, CA:true
[tsa]
basicConstraints = critical, CA:false
extendedKeyUsage = critical, timeStamping
keyUsage = critical, digitalSignature
[tsa_config]
serial = {folder}/serial
default_policy = 1.2.3.4
digests = sha256, sha512
signer_digest = sha256
ess_cert_id_chain = no
ess_cert_id_alg = sha256
"""


@pytest.fixture(scope="session")
def authority(tmp_path_factory):
    """A time-stamping authority of openssl's: ``answer(request)``, and its certificate."""
    folder = tmp_path_factory.mktemp("tsa")
    (folder / "tsa.cnf").write_text(CONFIG.format(folder=folder))
    (folder / "serial").write_text("01\n")

    def openssl(*arguments, data=None):
        return subprocess.run(
            ["openssl", *map(str, arguments)],
            cwd=folder,
            input=data,
            capture_output=True,
            check=True,
            timeout=120,
        ).stdout

    new = ("req", "-config", "tsa.cnf", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
    openssl(
        *new,
        "-x509",
        "-extensions",
        "ca",
        "-subj",
        "/CN=root",
        "-keyout",
        "ca.key",
        "-out",
        "ca.pem",
        "-days",
        "9",
    )
    openssl(*new, "-subj", "/CN=tsa", "-keyout", "tsa.key", "-out", "tsa.csr")
    openssl(
        *(
            "x509",
            "-req",
            "-in",
            "tsa.csr",
            "-CA",
            "ca.pem",
            "-CAkey",
            "ca.key",
            "-set_serial",
            "2",
            "-days",
            "9",
        ),
        *("-extfile", "tsa.cnf", "-extensions", "tsa", "-out", "tsa.pem"),
    )

    def answer(request):
        (folder / "request.tsq").write_bytes(request)
        signer = ("-signer", "tsa.pem", "-inkey", "tsa.key")
        openssl(
            "ts",
            "-reply",
            "-config",
            "tsa.cnf",
            "-section",
            "tsa_config",
            "-queryfile",
            "request.tsq",
            *signer,
            "-out",
            "answer.tsr",
        )
        return (folder / "answer.tsr").read_bytes()

    return answer, folder / "ca.pem"
