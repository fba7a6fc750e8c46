"""A PostgreSQL server of a test run's own: a new cluster on a free port, for all workers, removed at the run's end."""

import contextlib
import json
import os
import secrets
import shutil
import socket
import subprocess
import tempfile
import uuid
from pathlib import Path

import pytest
from sqlalchemy import create_engine, make_url, text

from anisoscope.history.address import parse_address

STATE = "postgresql.json"


def programs() -> Path:
    """The folder of the newest PostgreSQL's programs."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    on_path = shutil.which("initdb")
    if not found and on_path is None:
        pytest.skip("PostgreSQL is not installed here (apt-get install postgresql)")
    return found[-1].parent if found else Path(on_path).resolve().parent


def run(folder: Path, *command) -> None:
    """Run a program of the server's in its folder; the server refuses to run as root."""
    as_server = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    done = subprocess.run(
        [*as_server, *map(str, command)], cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr


def new_folder(prefix: str) -> Path:
    """A folder for a cluster, owned by who runs the server; its path is short, because a socket lies there."""
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    if os.geteuid() == 0:
        shutil.chown(folder, "postgres")
    return folder


def initialise(folder: Path, password: str) -> Path:
    """Make a cluster with the user ``anisoscope``; its data folder."""
    data, secret = folder / "data", folder / "password"
    secret.write_text(password)
    secret.chmod(0o644)  # in a folder that only the server's user may enter
    options = ("--auth", "scram-sha-256", "--encoding", "UTF8", "--no-sync")
    run(folder, programs() / "initdb", "-D", data, "-U", "anisoscope", "--pwfile", secret, *options)
    return data


def control(data: Path) -> tuple:
    """``pg_ctl`` for a cluster."""
    return programs() / "pg_ctl", "-D", data, "-s"


def start(folder: Path, data: Path, *settings: str) -> int:
    """Start the server on a free port: the server cannot choose one, and somebody else may take it first."""
    while True:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        chosen = ("listen_addresses=127.0.0.1", "fsync=off", *settings)
        options = f"-p {port} -k {folder} {' '.join(f'-c {setting}' for setting in chosen)}"
        log = folder / f"log-{port}"
        try:
            run(folder, *control(data), "-w", "-t", "120", "-l", log, "-o", options, "start")
        except AssertionError:
            if not log.exists() or "Address already in use" not in log.read_text():
                raise
        else:
            return port


def load(dump: Path, place: str) -> None:
    """Fill a database from a file of SQL statements."""
    done = subprocess.run(
        [programs() / "psql", "-q", "-v", "ON_ERROR_STOP=1", "-f", dump, place],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def stop(folder: Path, data: Path) -> None:
    """Stop the server and remove its folder."""
    try:
        run(folder, *control(data), "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def database(server: str):
    """The URL of a new, empty database on a server, removed at the end."""
    name = f"anisoscope_{uuid.uuid4().hex}"
    engine = create_engine(parse_address(server).url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    yield make_url(server).set(database=name).render_as_string(hide_password=False)
    with engine.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    engine.dispose()


def address(run_folder: Path) -> str:
    """Address of the server of a test run; whichever worker asks first starts it."""
    import fcntl  # POSIX only; every run imports this module, also where no server is asked for

    programs()
    with (run_folder / "postgresql.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        state = run_folder / STATE
        if not state.exists():
            password, folder = secrets.token_hex(16), new_folder("anisoscope-postgresql-")
            try:
                port = start(folder, initialise(folder, password))
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            at = f"postgresql://anisoscope:{password}@127.0.0.1:{port}/postgres"
            state.write_text(json.dumps({"address": at, "folder": str(folder)}))
        return json.loads(state.read_text())["address"]


def stop_server_of(run_folder: Path) -> None:
    """Stop the server of a test run, if one was started."""
    with contextlib.suppress(FileNotFoundError):
        folder = Path(json.loads((run_folder / STATE).read_text())["folder"])
        stop(folder, folder / "data")
