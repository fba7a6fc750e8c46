"""PostgreSQL that is reached encrypted only: a server of our own with a certificate that nobody else trusts."""

import shutil

import pytest
from sqlalchemy import text

from anisoscope.base.errors import UsageError
from anisoscope.history.address import parse_address
from anisoscope.history.problems import HistoryError
from anisoscope.history.store import open_history

PASSWORD = "gr8-secret"
# Nothing is let in but what is encrypted.
ENTRANCES = "local all all trust\nhostssl all all 127.0.0.1/32 scram-sha-256\n"


def encrypting(server, folder):
    """A running server with a certificate for ``localhost``, which it signed itself; its port."""
    data = server.initialise(folder, PASSWORD)
    key, certificate = data / "server.key", data / "server.crt"
    made = ("-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    name = ("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost")
    server.run(folder, "openssl", "req", *made, *name, "-keyout", key, "-out", certificate)
    shutil.copyfile(certificate, folder / "root.crt")
    (data / "pg_hba.conf").write_text(ENTRANCES)
    return server.start(folder, data, "ssl=on")


@pytest.fixture(scope="module")
def encrypted(postgresql_programs):
    """``encrypted("sslmode=require", host="127.0.0.1")`` is the address of the history."""
    server = postgresql_programs
    server.programs()
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed here (apt-get install openssl)")
    folder = server.new_folder("anisoscope-encrypted-")
    try:
        port = encrypting(server, folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    root = str(folder / "root.crt")

    def address(query, host="127.0.0.1"):
        query = query.replace("ROOT", root)
        return f"postgresql://anisoscope:{PASSWORD}@{host}:{port}/postgres?{query}"

    yield address
    server.stop(folder, folder / "data")


@pytest.mark.parametrize(
    ("query", "host"),
    [
        ("", "127.0.0.1"),
        ("sslmode=prefer", "127.0.0.1"),
        ("sslmode=require", "127.0.0.1"),
        ("sslmode=verify-ca&sslrootcert=ROOT", "127.0.0.1"),
        ("sslmode=verify-full&sslrootcert=ROOT", "localhost"),
    ],
)
def test_a_history_is_written_and_read_encrypted(encrypted, new_row, query, host):
    with open_history(encrypted(query, host)) as history:
        assert history.append(new_row(1)).serial == "A1"
        assert history.verify_chain() == []
        with history._database.reading() as connection:
            own = "SELECT ssl, version FROM pg_stat_ssl WHERE pid = pg_backend_pid()"
            used, version = connection.execute(text(own)).one()
    assert used
    assert version in {"TLSv1.2", "TLSv1.3"}


@pytest.mark.parametrize(
    ("query", "host", "said"),
    [
        ("sslmode=disable", "127.0.0.1", "no encryption"),
        ("sslmode=verify-full", "localhost", "its certificate is not trusted: self-signed certificate"),
        ("sslmode=verify-ca", "127.0.0.1", "its certificate is not trusted: self-signed certificate"),
        (
            "sslmode=verify-full&sslrootcert=ROOT",
            "127.0.0.1",
            "its certificate is not trusted: IP address mismatch",
        ),
    ],
)
def test_whom_one_does_not_trust_is_told_nothing(encrypted, query, host, said):
    with pytest.raises(HistoryError) as caught:
        open_history(encrypted(query, host))
    message = str(caught.value).replace("self signed", "self-signed")
    assert said in message
    assert PASSWORD not in message
    assert "\n" not in message


def test_a_server_that_does_not_encrypt_is_refused(postgresql_place):
    with pytest.raises(HistoryError, match="refuses SSL"):
        open_history(f"{postgresql_place}?sslmode=require")


def test_certificates_that_are_none(tmp_path):
    (tmp_path / "none.crt").write_text("no certificate")
    for path in (tmp_path / "none.crt", tmp_path / "missing.crt"):
        with pytest.raises(UsageError, match="holds no certificate that can be read"):
            parse_address(f"postgresql://h/db?sslmode=verify-full&sslrootcert={path}")
    with pytest.raises(
        UsageError, match="sslrootcert is looked at with sslmode=verify-ca or verify-full only"
    ):
        parse_address("postgresql://h/db?sslmode=require&sslrootcert=root.crt")
