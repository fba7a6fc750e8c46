"""Signed heads of the history, and the time that an authority stamps on them."""

import base64
import http.server
import subprocess
import threading
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import text

from anisoscope.base.errors import UsageError
from anisoscope.base.signature import Trust, TrustedKey, make_key
from anisoscope.history.covariates import CycleData
from anisoscope.history.heads import (
    EVERY,
    add_time_stamp,
    asked_of,
    sign_head,
    time_stamp_request,
    verify_heads,
)
from anisoscope.history.problems import HistoryError
from anisoscope.history.store import open_history


@pytest.fixture
def key(tmp_path):
    return make_key(tmp_path / "rig.pem")


@pytest.fixture
def trust(key):
    public = base64.b64encode(key.public).decode()
    return Trust(schema=1, keys=(TrustedKey(station="east", public=public),))


def bare(history, *statements):
    """Statements of somebody who may do everything, and puts the triggers back."""
    with history._database.engine.begin() as connection:
        saved = connection.execute(text("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'")).all()
        for name, _ in saved:
            connection.execute(text(f"DROP TRIGGER {name}"))
        for statement in statements:
            connection.execute(text(statement))
        for _, sql in saved:
            connection.execute(text(sql))


def test_a_head_is_signed_at_intervals(history, new_row, key, trust):
    history.append(new_row(0))
    assert sign_head(history, key)
    assert not sign_head(history, key, always=True)  # nothing is new
    history.append(new_row(1))
    assert not sign_head(history, key)
    assert sign_head(history, key, now=datetime.now(UTC) + timedelta(hours=25))
    history.append_all([new_row(number) for number in range(2, 2 + EVERY)])
    assert sign_head(history, key)
    history.dispose(1, reviewer="Q", decision="hold")
    assert sign_head(history, key)
    history.append(new_row(900))
    found = verify_heads(history, trust)
    assert (found.heads, found.covered, found.unsigned, found.problems) == (4, 2 + EVERY, 1, ())
    assert found.signed_by.startswith("east (ed25519:")
    assert history.verify_chain() == []


def test_without_a_signed_head_nothing_is_trusted(history, new_row, trust):
    history.append(new_row(0))
    assert verify_heads(history).problems == ()
    assert verify_heads(history, trust).problems == ("no head of the history is signed",)


@pytest.mark.parametrize(
    ("statements", "says"),
    [
        (["DELETE FROM inspections WHERE id = 6"], "signed head 2: the history held 6 inspections then"),
        (
            ["UPDATE inspections SET hash = zeroblob(32) WHERE id = 3"],
            "signed head 1: inspection 3 is another one",
        ),
        (["DELETE FROM dispositions"], "signed head 2: the history held 1 dispositions then, and was cut"),
        (["DELETE FROM signed_heads WHERE id = 1"], "signed head 2: one before it is missing"),
        (["UPDATE signed_heads SET inspections = 2 WHERE id = 1"], "its number of inspections was changed"),
        (
            ["UPDATE signed_heads SET envelope = replace(envelope, 'ed25519', 'rsa')"],
            "signed head 2: does not follow the one before it",
        ),
        (["UPDATE signed_heads SET envelope = '{}' WHERE id = 2"], "signed head 2: it is no signature"),
    ],
)
def test_what_is_written_anew_or_cut_differs_from_the_signed_heads(
    sqlite_history, new_row, key, trust, statements, says
):
    sqlite_history.append_all([new_row(number) for number in range(3)])
    sign_head(sqlite_history, key)
    sqlite_history.append_all([new_row(number) for number in range(3, 6)])
    sqlite_history.dispose(1, reviewer="Q", decision="hold")
    sign_head(sqlite_history, key)
    assert verify_heads(sqlite_history, trust).problems == ()
    bare(sqlite_history, *statements)
    assert any(says in line for line in verify_heads(sqlite_history, trust).problems)


def test_a_head_of_another_key_is_not_trusted(sqlite_history, new_row, trust, tmp_path):
    sqlite_history.append(new_row(0))
    sign_head(sqlite_history, make_key(tmp_path / "thief.pem"))
    line, nobody = verify_heads(sqlite_history, trust).problems
    assert "is not among the trusted ones" in line
    assert nobody == "no head is signed by the station east, which has 1 inspections here"
    assert verify_heads(sqlite_history).problems == ()


def test_an_authority_stamps_the_time_on_a_signed_head(history, new_row, key, trust, authority, tmp_path):
    answer, root = authority
    history.append(new_row(0))
    with pytest.raises(UsageError, match="has no signed head"):
        time_stamp_request(history)
    sign_head(history, key)
    response = answer(time_stamp_request(history))
    begun = datetime.now(UTC)
    assert abs(add_time_stamp(history, response) - begun) < timedelta(hours=1)
    found = verify_heads(history, trust, root)
    assert found.problems == ()
    assert abs(found.stamped_at - begun) < timedelta(hours=1)
    history.append(new_row(1))
    sign_head(history, key, always=True)
    with pytest.raises(UsageError, match="something else than the last signed head"):
        add_time_stamp(history, response)
    with pytest.raises(UsageError, match="this is no time stamp"):
        add_time_stamp(history, b"no time stamp")
    other = tmp_path / "other.pem"
    subprocess.run(
        [
            "openssl",
            "req",
            "-x509",
            "-newkey",
            "ec",
            "-pkeyopt",
            "ec_paramgen_curve:P-256",
            "-nodes",
            "-subj",
            "/CN=other",
            "-keyout",
            "/dev/null",
            "-out",
            other,
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    found = verify_heads(history, trust, other)
    assert found.stamped_at is None
    assert found.problems[0].startswith("time stamp 1: ")


def test_an_authority_is_asked_by_http(sqlite_history, new_row, key, authority):
    answer, root = authority

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            assert self.headers["Content-Type"] == "application/timestamp-query"
            found = answer(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(200)
            self.end_headers()
            self.wfile.write(found)

        def log_message(self, *_):
            pass

    sqlite_history.append(new_row(0))
    sign_head(sqlite_history, key)
    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        url = f"http://127.0.0.1:{server.server_port}/tsa"
        add_time_stamp(sqlite_history, asked_of(url, time_stamp_request(sqlite_history)))
        thread.join()
    assert verify_heads(sqlite_history, None, root).stamped_at is not None
    with pytest.raises(HistoryError, match="does not answer"):
        asked_of("http://127.0.0.1:1/", b"")
    with pytest.raises(UsageError, match="http"):
        asked_of("file:///etc/passwd", b"")


def test_an_earlier_history_has_no_signed_heads(place, new_row, key, trust):
    from anisoscope.history import schema
    from anisoscope.history.address import parse_address
    from anisoscope.history.database import Database

    database = Database(parse_address(place))
    with database.writing() as connection:
        schema.migrate(connection, to=3)
    database.close()
    with open_history(place) as history:
        assert verify_heads(history).heads == 0
        assert verify_heads(history, trust).problems == ("no head of the history is signed",)
        history.append(new_row(0))
        assert sign_head(history, key)
        assert verify_heads(history, trust).problems == ()


def test_cycle_data_are_under_the_signed_heads(sqlite_history, new_row, key, trust):
    sqlite_history.append(new_row(0))
    assert sign_head(sqlite_history, key)
    cycles = [
        CycleData(at=None, serial=f"A{k}", source="cycles.csv", numbers={"melt": 1.0 * k}) for k in range(3)
    ]
    sqlite_history.add_covariates(cycles)
    assert sign_head(sqlite_history, key, always=True)
    assert not sign_head(sqlite_history, key, always=True)
    assert verify_heads(sqlite_history, trust).problems == ()
    bare(sqlite_history, "DELETE FROM covariates WHERE id = 3")
    (line,) = verify_heads(sqlite_history, trust).problems
    assert "signed head 2: the history held 3 covariates then, and was cut" in line
