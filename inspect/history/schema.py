"""Tables of a history, how they refuse changes, and how an older database becomes a present one."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    func,
    insert,
    inspect,
    select,
    text,
)

from anisoscope.history.problems import HistoryError

metadata = MetaData()
_id = BigInteger().with_variant(Integer, "sqlite")

versions = Table(
    "schema_versions",
    metadata,
    Column("version", _id, primary_key=True, autoincrement=False),
    Column("applied_us", BigInteger, nullable=False),
)
# Labels of numbers are the same in all rows of a recipe, so that they are kept once.
layouts = Table(
    "layouts",
    metadata,
    Column("id", _id, primary_key=True, autoincrement=False),
    Column("digest", LargeBinary, nullable=False, unique=True),
    Column("labels", Text, nullable=False),
)
inspections = Table(
    "inspections",
    metadata,
    Column("id", _id, primary_key=True, autoincrement=False),
    Column("created_us", BigInteger, nullable=False),
    Column("serial", Text, nullable=False),
    Column("product", Text, nullable=False),
    Column("recipe", Text, nullable=False),
    Column("lot", Text),
    Column("cavity", Text),
    Column("station", Text),
    Column("operator", Text),
    Column("verdict", Text, nullable=False),
    Column("reasons", Text, nullable=False),
    Column("folder", Text, nullable=False),
    Column("seal", LargeBinary, nullable=False, unique=True),
    Column("software", Text, nullable=False),
    Column("layout", _id, ForeignKey("layouts.id"), nullable=False),
    Column("numbers", LargeBinary, nullable=False),
    Column("previous", LargeBinary, nullable=False),
    Column("hash", LargeBinary, nullable=False),
    Index("inspections_by_time", "created_us"),
    Index("inspections_by_serial", "serial"),
    Index("inspections_by_lot", "lot", "created_us"),
    Index("inspections_by_verdict", "verdict", "created_us"),
)
dispositions = Table(
    "dispositions",
    metadata,
    Column("id", _id, primary_key=True, autoincrement=False),
    Column("inspection", _id, ForeignKey("inspections.id"), nullable=False),
    Column("created_us", BigInteger, nullable=False),
    Column("reviewer", Text, nullable=False),
    Column("decision", Text, nullable=False),
    Column("comment", Text, nullable=False),
    Column("previous", LargeBinary, nullable=False),
    Column("hash", LargeBinary, nullable=False),
    Index("dispositions_by_inspection", "inspection"),
)
# Heads of both chains, signed by a station: an envelope of `anisoscope.base.signature`.
signed_heads = Table(
    "signed_heads",
    metadata,
    Column("id", _id, primary_key=True, autoincrement=False),
    Column("inspections", BigInteger, nullable=False),
    Column("dispositions", BigInteger, nullable=False),
    Column("envelope", Text, nullable=False),
)
# What a time-stamping authority answered for a signed head (RFC 3161).
time_stamps = Table(
    "time_stamps",
    metadata,
    Column("id", _id, primary_key=True, autoincrement=False),
    Column("signed_head", _id, ForeignKey("signed_heads.id"), nullable=False),
    Column("response", LargeBinary, nullable=False),
)
# Cycle data of machines: numbers of a moment, or of the part with a serial number.
covariates = Table(
    "covariates",
    metadata,
    Column("id", _id, primary_key=True, autoincrement=False),
    Column("measured_us", BigInteger),
    Column("serial", Text),
    Column("source", Text, nullable=False),
    Column("layout", _id, ForeignKey("layouts.id"), nullable=False),
    Column("numbers", LargeBinary, nullable=False),
    Column("digest", LargeBinary, nullable=False, unique=True),
    Column("previous", LargeBinary, nullable=False),
    Column("hash", LargeBinary, nullable=False),
)
# What each station does now, and when it said so last: the one table whose rows are replaced.
stations = Table(
    "stations",
    metadata,
    Column("station", Text, primary_key=True),
    Column("doing", Text, nullable=False),
    Column("words", Text, nullable=False),
    Column("since_us", BigInteger, nullable=False),
    Column("seen_us", BigInteger, nullable=False),
)
# First eight bytes of the SHA-256 of the pixels of each pose's first frame: whose pictures they were first.
pictures = Table(
    "pictures",
    metadata,
    Column("pixels", BigInteger, primary_key=True, autoincrement=False),
    Column("inspection", _id, ForeignKey("inspections.id"), primary_key=True, autoincrement=False),
    sqlite_with_rowid=False,
)
GUARDED = (versions, layouts, inspections, dispositions, signed_heads, time_stamps, covariates, pictures)
_REFUSAL = "the history is append-only"


def _first(connection: Connection) -> None:
    """Version 1: inspections."""
    metadata.create_all(connection, [versions, layouts, inspections])
    if connection.dialect.name == "postgresql":
        connection.execute(text(_POSTGRESQL_REFUSAL))
    for table in (versions, layouts, inspections):
        _guard(connection, table)


def _second(connection: Connection) -> None:
    """Version 2: dispositions."""
    metadata.create_all(connection, [dispositions])
    _guard(connection, dispositions)


def _third(connection: Connection) -> None:
    """Version 3: new rows hold numbers of single precision, which earlier programs would not understand."""
    del connection


def _fourth(connection: Connection) -> None:
    """Version 4: signed heads; and every filter finds what is rare, or not there at all, without reading all rows."""
    for name in ("product", "recipe", "cavity", "station", "operator"):
        connection.execute(
            text(f"CREATE INDEX IF NOT EXISTS inspections_by_{name} ON inspections ({name}, created_us)")
        )
    metadata.create_all(connection, [signed_heads, time_stamps])
    for table in (signed_heads, time_stamps):
        _guard(connection, table)
    if connection.dialect.name == "postgresql":  # rigs that may add inspections may add their signatures
        connection.execute(text(_grants("signed_heads, time_stamps")))


def _fifth(connection: Connection) -> None:
    """Version 5: cycle data of machines."""
    metadata.create_all(connection, [covariates])
    _guard(connection, covariates)
    if connection.dialect.name == "postgresql":
        connection.execute(text(_grants("covariates")))


def _sixth(connection: Connection) -> None:
    """Version 6: signs of stations."""
    metadata.create_all(connection, [stations])
    if connection.dialect.name == "postgresql":
        connection.execute(text(_grants("stations", "SELECT, INSERT, UPDATE")))


def _seventh(connection: Connection) -> None:
    """Version 7: pictures of the inspections added from now on."""
    metadata.create_all(connection, [pictures])
    _guard(connection, pictures)
    if connection.dialect.name == "postgresql":
        connection.execute(text(_grants("pictures")))


def _grants(names: str, rights: str = "SELECT, INSERT") -> str:
    """Statement: rights on tables for those who may add inspections."""
    return _POSTGRESQL_GRANTS.format(rights=rights, tables=names)


MIGRATIONS: Sequence[Callable[[Connection], None]] = (
    _first,
    _second,
    _third,
    _fourth,
    _fifth,
    _sixth,
    _seventh,
)
VERSION = len(MIGRATIONS)
WITH_DISPOSITIONS, WITH_SIGNED_HEADS, WITH_COVARIATES, WITH_STATIONS, WITH_PICTURES = 2, 4, 5, 6, 7
"""Versions that brought tables; those before the first cannot be read without being brought up to date."""


def version_of(connection: Connection) -> int:
    """Version of the tables in a database; 0 without tables."""
    if not inspect(connection).has_table(versions.name):
        return 0
    return int(connection.scalar(select(func.coalesce(func.max(versions.c.version), 0))) or 0)


def tables(connection: Connection) -> list[str]:
    """Names of all tables of a database."""
    return sorted(inspect(connection).get_table_names())


def check_version(found: int, where: object) -> None:
    """Check that this program can read the tables.

    Raises:
        HistoryError: they are of a later program.
    """
    if found > VERSION:
        raise HistoryError(
            f"the history {where} was made by a later anisoscope (version {found} of its tables, this one knows "
            f"{VERSION}): update anisoscope here"
        )


def migrate(connection: Connection, to: int = VERSION) -> None:
    """Bring the tables of a database to a version, step by step, within the caller's transaction."""
    for number in range(version_of(connection), to):
        MIGRATIONS[number](connection)
        now = int(datetime.now(UTC).timestamp() * 1e6)
        connection.execute(insert(versions).values(version=number + 1, applied_us=now))


def unguarded(connection: Connection) -> list[str]:
    """Tables whose triggers against changes are missing, or do something else."""
    if connection.dialect.name == "postgresql":
        present = {
            _plain(f"{definition} {source}")
            for definition, source in connection.execute(text(_POSTGRESQL_TRIGGERS))
        }
        suffix = f" {_POSTGRESQL_BODY}"
    else:
        statement = "SELECT sql FROM sqlite_master WHERE type = 'trigger'"
        present = {_plain(definition) for definition in connection.scalars(text(statement))}
        suffix = ""
    version = version_of(connection)
    since = ((WITH_SIGNED_HEADS, 4), (WITH_COVARIATES, 6), (WITH_PICTURES, 7))
    guarded = GUARDED[: next((count for first, count in since if version < first), None)]
    return [
        table.name
        for table in guarded
        if not {_plain(trigger + suffix) for trigger in _triggers(connection, table)} <= present
    ]


def _plain(statement: str) -> str:
    return " ".join(statement.split())


def _triggers(connection: Connection, table: Table) -> list[str]:
    """Statements of triggers that refuse to change or remove a row of a table."""
    names = f"CREATE TRIGGER {table.name}_refuse"
    if connection.dialect.name == "postgresql":
        refuse = "EXECUTE FUNCTION anisoscope_refuse()"
        return [
            f"{names}_update BEFORE UPDATE ON {table.name} FOR EACH ROW {refuse}",
            f"{names}_delete BEFORE DELETE ON {table.name} FOR EACH ROW {refuse}",
            f"{names}_truncate BEFORE TRUNCATE ON {table.name} FOR EACH STATEMENT {refuse}",
        ]
    refuse = f"BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END"
    clash = f"EXISTS (SELECT 1 FROM {table.name} WHERE {_clash(table)})"  # noqa: S608 - names of ours
    return [
        f"{names}_update BEFORE UPDATE ON {table.name} {refuse}",
        f"{names}_delete BEFORE DELETE ON {table.name} {refuse}",
        # INSERT OR REPLACE removes rows without asking the trigger of removals
        f"{names}_replace BEFORE INSERT ON {table.name} WHEN {clash} {refuse}",
    ]


def _guard(connection: Connection, table: Table) -> None:
    for statement in _triggers(connection, table):
        connection.execute(text(statement))


def _clash(table: Table) -> str:
    """Condition: another row already has the same key, or the same unique value."""
    names = [column.name for column in table.columns if column.primary_key or column.unique]
    if table is pictures:  # one key of two columns
        return " AND ".join(f"{name} = NEW.{name}" for name in names)
    return " OR ".join(f"{name} = NEW.{name}" for name in names)


_POSTGRESQL_BODY = f"BEGIN RAISE EXCEPTION '{_REFUSAL}'; END"
_POSTGRESQL_REFUSAL = f"""
CREATE OR REPLACE FUNCTION anisoscope_refuse() RETURNS trigger LANGUAGE plpgsql AS $body$
{_POSTGRESQL_BODY} $body$
"""
_POSTGRESQL_GRANTS = """
DO $body$ DECLARE rig text; BEGIN
FOR rig IN SELECT DISTINCT grantee FROM information_schema.role_table_grants
WHERE table_schema = current_schema() AND table_name = 'inspections' AND privilege_type = 'INSERT'
AND grantee NOT IN (current_user, 'PUBLIC')
LOOP EXECUTE format('GRANT {rights} ON {tables} TO %I', rig); END LOOP;
END $body$
"""
_POSTGRESQL_TRIGGERS = """
SELECT pg_get_triggerdef(t.oid, true), p.prosrc
FROM pg_trigger t JOIN pg_class c ON c.oid = t.tgrelid JOIN pg_proc p ON p.oid = t.tgfoid
WHERE t.tgenabled IN ('O', 'A') AND c.relnamespace = current_schema()::regnamespace
"""
