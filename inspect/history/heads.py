"""Signed heads: a station signs the ends of all chains now and then, and an authority may stamp the time on them.

Whoever writes the chains anew cannot sign for the station, and a head names how many rows there were. Time stamps are
those of RFC 3161; they are read and checked by the package rfc3161-client, an extra.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.error import URLError
from urllib.request import Request, urlopen

from sqlalchemy import Connection, func, insert, select

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.base.last_signed import HEADS, note_head, note_of, noted
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.signature import Signed, Signer, Trust, clock_set_back, key_id, read_signed, signed
from anisoscope.history import schema
from anisoscope.history.chain import INSPECTION_FIELDS, START, text_of
from anisoscope.history.evidence import compare_rows
from anisoscope.history.problems import HistoryError
from anisoscope.history.statements import head
from anisoscope.history.store import History

EVERY = 100
AFTER = timedelta(hours=24)
"""A head is signed when so many inspections are new, or the last one is so old."""
MOST_COMPARED = 1000
"""So many of the latest rows are compared with their records before a head is signed by itself."""
_HEADS, _STAMPS = schema.signed_heads, schema.time_stamps
_WAIT_S = 30


@dataclass(frozen=True)
class HeadsVerified:
    """Outcome of checking the signed heads of a history.

    Attributes:
        heads: how many there are.
        covered: how many inspections the last one covers.
        unsigned: how many came after it.
        signed_by: station and key of the last one, or None.
        stamped_at: the time of the last time stamp that was checked, or None.
        problems: what is wrong, a line each.
        signed_since: by station, how many rows its first head covers.
        remarks: heads signed by a clock that was set back.
    """

    heads: int
    covered: int
    unsigned: int
    signed_by: str | None
    stamped_at: datetime | None
    problems: tuple[str, ...] = field(metadata=LEFT_OUT)
    signed_since: Mapping[str, int] = field(default_factory=dict, metadata=LEFT_OUT)
    remarks: tuple[str, ...] = field(default=(), metadata=LEFT_OUT)


def sign_head(history: History, signer: Signer, *, always: bool = False, now: datetime | None = None) -> bool:
    """Sign the present heads if that is due: the first time, after 100 inspections, or after a day with something new.

    Each station signs heads of its own. The rows that are new under the head are compared with their records first; the
    last head has to be true, and the last one that this key signed, by the note beside it, has to be there.

    Args:
        history: open.
        signer: the key of the station.
        always: whether it is due or not; then the rows are compared however many they are.
        now: the time.

    Returns:
        Whether they were signed.

    Raises:
        HistoryError: the history cannot be written, a row differs from its record, or a head is gone.
        ConfigError: the note beside the key is damaged.
    """
    with history.writing() as connection:
        rows, after = _due(connection, signer, always, now or datetime.now(UTC))
        changed = [*_last_unlike(connection)]
    problems = [*changed, *cut(history, signer)]
    if rows is None and not problems:
        return False
    rows = rows or 0
    problems += compare_rows(history, after=after if always else max(after, rows - MOST_COMPARED)).problems
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise HistoryError(f"{problems[0]}{more}: `anisoscope history verify` says more; nothing is signed")
    with history.writing() as connection:
        last = connection.execute(select(_HEADS).order_by(_HEADS.c.id.desc()).limit(1)).mappings().first()
        number, previous = (0, "") if last is None else (last["id"], last["envelope"])
        row_hash = connection.scalar(select(schema.inspections.c.hash).where(schema.inspections.c.id == rows))
        (decisions, decision_hash), (cycles, cycle_hash) = (
            head(connection, table) for table in (schema.dispositions, schema.covariates)
        )
        statement = {
            "number": number + 1,
            "inspections": rows,
            "head": (bytes(row_hash) if row_hash is not None else START).hex(),
            "dispositions": decisions,
            "disposition_head": decision_hash.hex(),
            "covariates": cycles,
            "covariate_head": cycle_hash.hex(),
            "previous": hashlib.sha256(previous.encode()).hexdigest() if previous else START.hex(),
        }
        values = {"id": number + 1, "inspections": rows, "dispositions": decisions}
        envelope = signed("head", statement, signer, now)
        connection.execute(insert(_HEADS).values(**values, envelope=envelope))
    note_head(signer, str(history.address), number + 1, envelope)
    return True


def _due(connection: Connection, signer: Signer, always: bool, now: datetime) -> tuple[int | None, int]:
    """How many rows a head by this key is to cover, or None where none is due; and those that need no comparison."""
    newest = select(_HEADS).order_by(_HEADS.c.id.desc()).limit(1)
    mine = newest.where(_HEADS.c.envelope.like(f"%{key_id(signer.public)}%"))
    last, own = (connection.execute(one).mappings().first() for one in (newest, mine))
    rows, decisions, cycles = (
        head(connection, table)[0] for table in (schema.inspections, schema.dispositions, schema.covariates)
    )
    if own is None:
        return rows, 0 if last is None else last["inspections"]
    signed_at, signed_cycles = _said(own["envelope"])
    if (rows, decisions, cycles) == (own["inspections"], own["dispositions"], signed_cycles):
        return None, 0
    new = always or rows - own["inspections"] >= EVERY or decisions != own["dispositions"]
    return (rows if new or now - signed_at >= AFTER else None), own["inspections"]


def cut(history: History, signer: Signer) -> Iterator[str]:
    """That the last head which this key signed is gone, by the note next to it.

    Raises:
        HistoryError, ConfigError: the history, or the note, cannot be read.
    """
    note, place = noted(signer)[HEADS].get(str(history.address)), note_of(signer)
    if note is not None:
        yield from gone(history, f"{place}: if this history was restored from a copy, remove it there", note)


def gone(history: History, where: str, note: Mapping[str, Any]) -> Iterator[str]:
    """That a history does not hold a signed head which was noted elsewhere.

    Args:
        history: open.
        where: where it was noted.
        note: its ``number``, and the ``sha256`` of its envelope.

    Raises:
        HistoryError: the history cannot be read.
    """
    with history.reading() as connection:
        there = schema.version_of(connection) >= schema.WITH_SIGNED_HEADS
        chosen = select(_HEADS.c.envelope).where(_HEADS.c.id == note["number"])
        envelope = connection.scalar(chosen) if there else None
    if envelope is None or hashlib.sha256(str(envelope).encode()).hexdigest() != note["sha256"]:
        yield (
            f"signed head {note['number']} was noted, and the history does not hold it: it was cut or written anew "
            f"(noted in {where})"
        )


def _said(envelope: str) -> tuple[datetime, int]:
    """When a head was signed, and how many cycle data it covers."""
    try:
        found = read_signed("head", envelope)
    except ValueError:
        return datetime.min.replace(tzinfo=UTC), 0  # `verify_heads` says what is wrong with it
    cycles = found.content.get("covariates", 0)
    return found.signed_at, cycles if isinstance(cycles, int) else 0


def verify_heads(
    history: History, trust: Trust | None = None, authorities: Path | None = None
) -> HeadsVerified:
    """Check that every signed head is in the chains, and follows the one before it.

    Args:
        history: open.
        trust: keys that have to have signed; there has to be a signed head then.
        authorities: certificates (PEM) of time-stamping authorities; without them time stamps are not looked at.

    Raises:
        HistoryError: the history cannot be read.
        UsageError: the certificates cannot be read, or the extra for time stamps is not installed.
    """
    problems, remarks = list[str](), list[str]()
    last: Signed | None = None
    covered, previous, count, name = 0, "", 0, None
    by: dict[str, list[int]] = {}
    with history.reading() as connection:
        rows = head(connection, schema.inspections)[0]
        there = schema.version_of(connection) >= schema.WITH_SIGNED_HEADS
        found = connection.execute(select(_HEADS).order_by(_HEADS.c.id)).mappings().all() if there else []
        for row in found:
            count += 1
            where = f"signed head {row['id']}"
            if row["id"] != count:
                problems.append(f"{where}: one before it is missing")
                count = row["id"]
            before = last
            try:
                last = read_signed("head", row["envelope"])
            except ValueError as error:
                problems.append(f"{where}: {error}")
                previous = row["envelope"]
                continue
            problems += [f"{where}: {line}" for line in _unlike(connection, row, last, previous)]
            back = None if before is None else clock_set_back(before, last)
            remarks += [] if back is None else [f"{where}: {back}"]
            wrong = None if trust is None else trust.distrust(last)
            problems += [] if wrong is None else [f"{where}: {wrong}"]
            covered, previous = max(covered, row["inspections"]), row["envelope"]
            name = last.key if trust is None else trust.station(last)
            known = None if trust is None or wrong is not None else trust.key(last.public)
            if known is not None:
                by.setdefault(known.station, []).append(row["inspections"])
        if trust is not None:
            problems += [] if found else ["no head of the history is signed"]
            problems += _uncovered(connection, by) if found else []
        stamps = connection.execute(select(_STAMPS).order_by(_STAMPS.c.id)).mappings().all() if there else []
    moment, stamp_problems = (
        (None, []) if authorities is None else _stamps(stamps, {row["id"]: row for row in found}, authorities)
    )
    since = {station: covers[0] for station, covers in by.items()}
    return HeadsVerified(
        len(found),
        covered,
        max(rows - covered, 0),
        name,
        moment,
        (*problems, *stamp_problems),
        since,
        tuple(remarks),
    )


def _uncovered(connection: Connection, by: Mapping[str, list[int]]) -> Iterator[str]:
    """Stations whose own heads do not cover their rows: no other station signs for them."""
    table = schema.inspections.c
    stations = select(table.station, func.count()).where(table.station.is_not(None)).group_by(table.station)
    for station, number in connection.execute(stations.order_by(table.station)).all():
        if station not in by:
            yield f"no head is signed by the station {station}, which has {number} inspections here"
            continue
        later = select(func.count()).where(table.station == station, table.id > max(by[station]))
        left = int(connection.scalar(later) or 0)
        if left > EVERY:
            yield (
                f"{left} inspections of the station {station} came after its last signed head: `anisoscope history "
                "sign` there covers them"
            )


def _last_unlike(connection: Connection) -> Iterator[str]:
    """How the last signed head differs from what the history holds now."""
    rows = connection.execute(select(_HEADS).order_by(_HEADS.c.id.desc()).limit(2)).mappings().all()
    if rows:
        try:
            said = read_signed("head", rows[0]["envelope"])
        except ValueError as error:
            yield f"signed head {rows[0]['id']}: {error}"
            return
        previous = rows[1]["envelope"] if len(rows) > 1 else ""
        yield from (
            f"signed head {rows[0]['id']}: {one}" for one in _unlike(connection, rows[0], said, previous)
        )


def _unlike(connection: Connection, row: Any, said: Signed, previous: str) -> list[str]:  # noqa: ANN401
    """How a signed head differs from the chains, from its own columns, and from the head before it."""
    content, found = said.content, []
    before = hashlib.sha256(previous.encode()).hexdigest() if previous else START.hex()
    if content.get("previous") != before or content.get("number") != row["id"]:
        found.append("does not follow the one before it")
    chains = [
        (schema.inspections, "inspections", "head"),
        (schema.dispositions, "dispositions", "disposition_head"),
    ]
    if "covariates" in content:  # version 5 of the tables
        chains.append((schema.covariates, "covariates", "covariate_head"))
    for table, count, name in chains:
        number = content.get(count)
        if number != row.get(count, number):
            found.append(f"its number of {count} was changed")
        hash_ = connection.scalar(select(table.c.hash).where(table.c.id == number)) if number else START
        if hash_ is None:
            found.append(f"the history held {number} {count} then, and was cut since")
        elif bytes(hash_).hex() != content.get(name):
            found.append(f"{count[:-1]} {number} is another one now: the history was written anew")
    return found


def rows_to_head(history: History, row_id: int) -> tuple[list[str], str]:
    """The rows from an inspection to the first signed head after it, as they are hashed, and the head's envelope.

    Raises:
        UsageError: no signed head covers the inspection.
        HistoryError: the history cannot be read.
    """
    with history.reading() as connection:
        there = schema.version_of(connection) >= schema.WITH_SIGNED_HEADS
        covering = select(_HEADS.c.inspections, _HEADS.c.envelope).where(_HEADS.c.inspections >= row_id)
        found = connection.execute(covering.order_by(_HEADS.c.id).limit(1)).first() if there else None
        if found is None:
            raise UsageError(
                f"no signed head covers inspection {row_id} yet: `anisoscope history sign` signs the present one"
            )
        table = schema.inspections
        rows = select(table, schema.layouts.c.labels).join(
            schema.layouts, table.c.layout == schema.layouts.c.id
        )
        rows = rows.where(table.c.id >= row_id, table.c.id <= found[0]).order_by(table.c.id)
        texts = [
            text_of("inspection", INSPECTION_FIELDS, {str(name): value for name, value in row.items()})
            for row in connection.execute(rows).mappings()
        ]
    return texts, str(found[1])


def time_stamp_request(history: History) -> bytes:
    """Request of a time stamp for the last signed head (DER), as ``openssl ts -query`` writes it.

    Raises:
        UsageError: no head is signed, or the extra is not installed.
    """
    client, (_, envelope) = _client(), _last(history)
    request = (
        client.TimestampRequestBuilder().data(envelope.encode()).hash_algorithm(client.HashAlgorithm.SHA256)
    )
    return bytes(request.cert_request(cert_request=True).build().as_bytes())


def add_time_stamp(history: History, response: bytes) -> datetime:
    """Add an authority's answer for the last signed head to the history.

    Returns:
        The time that it states.

    Raises:
        UsageError: it is no time stamp, or one of something else.
        HistoryError: the history cannot be written.
    """
    number, envelope = _last(history)
    stamp = _stamp(response, envelope)
    with history.writing() as connection:
        new = int(connection.scalar(select(func.coalesce(func.max(_STAMPS.c.id), 0))) or 0) + 1
        connection.execute(insert(_STAMPS).values(id=new, signed_head=number, response=response))
    return _time(stamp)


def asked_of(url: str, request: bytes) -> bytes:
    """Answer of a time-stamping authority (RFC 3161 § 3.4, by HTTP).

    Raises:
        HistoryError: it cannot be reached, or refuses.
    """
    if not url.startswith(("http://", "https://")):
        raise UsageError(
            f"a time-stamping authority has an address with http:// or https://, not {url[:80]!r}"
        )
    headers = {"Content-Type": "application/timestamp-query", "Accept": "application/timestamp-reply"}
    try:
        with urlopen(Request(url, request, headers), timeout=_WAIT_S) as answer:  # noqa: S310 - checked above
            return bytes(answer.read(1 << 20))
    except (URLError, OSError, ValueError) as error:
        raise HistoryError(f"the time-stamping authority {url} does not answer: {error}") from error


def _last(history: History) -> tuple[int, str]:
    with history.reading() as connection:
        there = schema.version_of(connection) >= schema.WITH_SIGNED_HEADS
        last = select(_HEADS.c.id, _HEADS.c.envelope).order_by(_HEADS.c.id.desc()).limit(1)
        found = connection.execute(last).first() if there else None
    if found is None:
        raise UsageError(
            f"the history {history.address} has no signed head: `anisoscope history sign` makes one"
        )
    return int(found[0]), str(found[1])


def _client() -> ModuleType:
    try:
        import rfc3161_client
    except ImportError:
        raise UsageError(
            "time stamps need the package rfc3161-client: pip install 'anisoscope[timestamp]'"
        ) from None
    return rfc3161_client


def _stamp(response: bytes, envelope: str) -> Any:  # noqa: ANN401 - of the extra
    client = _client()
    try:
        stamp = client.decode_timestamp_response(response)
        imprint = bytes(stamp.tst_info.message_imprint.message)
    except ValueError as error:
        raise UsageError(f"this is no time stamp: {str(error).splitlines()[0]}") from None
    if imprint not in {hashlib.new(name, envelope.encode()).digest() for name in ("sha256", "sha512")}:
        raise UsageError("this is the time stamp of something else than the last signed head")
    return stamp


def _time(stamp: Any) -> datetime:  # noqa: ANN401
    found: datetime = stamp.tst_info.gen_time
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def _stamps(
    stamps: Sequence[Any], heads: dict[int, Any], authorities: Path
) -> tuple[datetime | None, list[str]]:
    """The latest time that authorities vouch for, and what is wrong with time stamps."""
    from cryptography.x509 import load_pem_x509_certificates

    client, moment, problems = _client(), None, list[str]()
    try:
        roots = load_pem_x509_certificates(bounded_bytes(authorities))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{authorities}: holds no certificates in PEM: {str(error).splitlines()[0]}"
        ) from None
    for row in stamps:
        where = f"time stamp {row['id']}"
        try:
            envelope = heads[row["signed_head"]]["envelope"]
            stamp = _stamp(bytes(row["response"]), envelope)
            builder = client.VerifierBuilder()
            for root in roots:
                builder = builder.add_root_certificate(root)
            builder.build().verify_message(stamp, envelope.encode())
            moment = _time(stamp)
        except KeyError:
            problems.append(f"{where}: its signed head is missing")
        except (UsageError, ValueError, client.VerificationError) as error:
            problems.append(f"{where}: {str(error).splitlines()[0]}")
    return moment, problems
