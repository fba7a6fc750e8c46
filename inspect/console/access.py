"""Who may do what: accounts, sessions in cookies, and the permission that every route names.

Without accounts the console has one user, who may do everything and sits at this computer. With accounts every session
begins without a role, and gets one by name and password.
"""

import hmac
import ipaddress
import math
import secrets
import threading
import unicodedata
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from fastapi import HTTPException, Request

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.console.accounts import ROLES, Account, Accounts, Role
from anisoscope.console.openid import Begun, OpenId, Person
from anisoscope.console.trail import Trail, trail_of

Permission = Literal["look", "stop", "operate", "set up", "review", "audit", "administer"]

PERMISSIONS: Mapping[Permission, frozenset[Role]] = {
    "look": frozenset(ROLES),
    "stop": frozenset(ROLES),  # whoever sees that a hand is in the rig
    "operate": frozenset({"operator", "engineer"}),
    "set up": frozenset({"engineer"}),
    "review": frozenset({"engineer", "auditor"}),
    "audit": frozenset({"auditor", "administrator"}),
    "administer": frozenset({"administrator"}),
}

COOKIE = "anisoscope_session"
TOKEN_HEADER = "x-csrf-token"
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
SESSION_S = 12 * 3600.0
"""A shift, and what comes before and after it."""
MOST_SESSIONS = 2000
IDLE_S = 30 * 60.0
"""After so long without a request of a person a session may only look and stop."""
TRIES, TRIES_OF_ALL = 5, 20
"""Wrong passwords without a wait: of a name at an address, and of a name or an address among all others."""
LONGEST_WAIT_S, FORGOTTEN_S = 60.0, 3600.0
SINGLE_USER = "this computer"
_LIKE = str.maketrans("аеорсухіјѕԁһӏοανικρτυχγ", "aeopcyxijsdhloavikptuxy")
"""Letters of Greek and Cyrillic that look like Latin ones."""


@dataclass
class Session:
    """A browser, or a program, and who uses it; no roles before the login."""

    id: str
    token: str
    name: str = ""
    roles: frozenset[Role] = frozenset()
    seen_s: float = 0.0
    ends_s: float = math.inf
    acted_s: float = 0.0
    account: Account | None = None
    begun: Begun | None = None

    @property
    def short(self) -> str:
        """A name of the session that opens nothing."""
        return sha256(self.id.encode()).hexdigest()[:12]

    def may(self, permission: Permission) -> bool:
        """Whether one of its roles has a permission."""
        return not self.roles.isdisjoint(PERMISSIONS[permission])


class Access:
    """Sessions of a running console.

    Args:
        accounts: the accounts; None for the one user of this computer.
        trail: where logins are recorded.
        clock: a monotonic clock in seconds.
        secure: whether cookies travel by TLS only.
        openid: logs people in by an OpenID provider, besides the accounts.
        idle_s: after so long without a request of a person a session may only look and stop.
    """

    def __init__(
        self,
        accounts: Accounts | None,
        trail: Trail,
        clock: Clock = SYSTEM,
        *,
        secure: bool = False,
        openid: OpenId | None = None,
        idle_s: float = IDLE_S,
    ) -> None:
        self.accounts, self.trail, self.secure, self.openid = accounts, trail, secure, openid
        self._clock = clock
        self._lock = threading.Lock()
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._people: dict[str, dict[str, str]] = {}
        self._idle_s = idle_s
        self._tries = _Tries(clock)
        self._checking = threading.Semaphore(2)  # a check takes 64 MiB

    def find(self, cookie: str | None) -> Session | None:
        """The session of a cookie, if it is one and still holds."""
        with self._lock:
            found = self._sessions.get(cookie or "")
            if found is None:
                return None
            if self._clock() - found.seen_s > SESSION_S or self._is_over(found):
                del self._sessions[found.id]
                return None
            found.seen_s = self._clock()
            self._sessions.move_to_end(found.id)
            return found

    def _is_over(self, session: Session) -> bool:
        """Whether its account is gone, locked, or has another role or password since, or its time is over."""
        account = session.account
        changed = (
            self.accounts is not None and account is not None and self.accounts.now(account.name) != account
        )
        return changed or self._clock() > session.ends_s

    def is_idle(self, session: Session) -> bool:
        """Whether it was left: no request of a person for the idle time. Then it may look and stop only."""
        return self.accounts is not None and self._clock() - session.acted_s > self._idle_s

    def act(self, session: Session) -> None:
        """A person works with a session."""
        session.acted_s = self._clock()

    def holds(self, session: Session) -> bool:
        """Whether a session is still one, for what it began and has not ended."""
        with self._lock:
            return self._sessions.get(session.id) is session and not self._is_over(session)

    def begin(self) -> Session:
        """A new session; the one unused for longest makes room for it."""
        session = Session(secrets.token_urlsafe(32), secrets.token_urlsafe(32))
        session.seen_s = session.acted_s = self._clock()
        if self.accounts is None:
            session.name, session.roles = SINGLE_USER, frozenset(ROLES)
        with self._lock:
            self._sessions[session.id] = session
            if len(self._sessions) > MOST_SESSIONS:
                # browsers that nobody logged in go before those at which somebody works
                idle = next((one.id for one in self._sessions.values() if not one.roles), None)
                self._sessions.pop(idle or next(iter(self._sessions)))
        return session

    def end(self, session: Session) -> None:
        """End a session."""
        with self._lock:
            self._sessions.pop(session.id, None)

    def log_in(self, name: str, password: str, address: str) -> Session | None:
        """A new session with the role of an account; None if name or password is wrong.

        Raises:
            HTTPException: 429 after too many wrong passwords, with the seconds to wait (`_Tries`).
        """
        assert self.accounts is not None
        taken = self._tries.take(name[:80], address)
        with self._checking:
            account = self.accounts.check(name, password)
        if account is None:
            self.trail.add(name[:80], "login refused", address=address)
            return None
        self._tries.give_back(taken)
        self.trail.add(account.name, "login", address=address)
        session = self.begin()
        session.name, session.roles, session.account = account.name, frozenset({account.role}), account
        return session

    def admit(self, person: Person, address: str) -> Session:
        """A new session of a person whom the OpenID provider knows.

        Raises:
            HTTPException: 403, the name is, or looks like, that of an account or of somebody else whom the provider
                knows: records could not tell them apart.
        """
        assert self.accounts is not None
        assert self.openid is not None
        like = _looks(person.name)
        found = next((name for name in (*self.accounts.read(), SINGLE_USER) if _looks(name) == like), None)
        if found is not None:
            text = message("There is an account {name} here: log in with its password.", name=found)
            raise HTTPException(403, text)
        issuer = self.openid.provider.issuer
        identity = {"issuer": issuer, "subject": person.subject}
        with self._lock:
            first = self._people.setdefault(like, identity)
        if first != identity:
            text = message(
                "Another person of {host} is {name} here.", host=self.openid.host, name=person.name
            )
            raise HTTPException(403, text)
        self.trail.identities[person.name] = identity
        self.trail.add(person.name, "login", address=address)
        session = self.begin()
        session.name, session.roles = person.name, person.roles
        session.ends_s = self._clock() + SESSION_S  # then the provider says again who may
        return session


def _looks(name: str) -> str:
    """A name as people read it: without case, spare blanks, and letters of other scripts that look like Latin ones."""
    return " ".join(unicodedata.normalize("NFKC", name).casefold().translate(_LIKE).split())


@dataclass
class _Count:
    """Wrong passwords in a row: their number, when the last one was, and when the next one is checked."""

    number: int = 0
    last_s: float = -math.inf
    next_s: float = -math.inf


@dataclass(eq=False)
class _Tries:
    """Tries to log in: a try counts as wrong before it is checked, so that many at once are no more than one by one.

    A name at an address has five; then it waits 1 s, 2 s, 4 s … up to a minute from try to try, whatever others do. All
    tries of a name, and all from an address, have twenty together, and wait likewise; who has logged in from an address
    before is not held up there by what others try.
    """

    clock: Clock
    _counts: OrderedDict[str, _Count] = field(default_factory=OrderedDict)
    _known: OrderedDict[str, None] = field(default_factory=OrderedDict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self, name: str, address: str) -> tuple[str, ...]:
        """Take a try; returns by what it is given back.

        Raises:
            HTTPException: 429, none is left for now.
        """
        place = _network(address)
        own, now = f"{name} at {place}", self.clock()
        with self._lock:
            shared = () if own in self._known else (f"name {name}", f"address {place}")
            counts = {key: self._counts.get(key, _Count()) for key in (own, *shared)}
            for count in counts.values():
                if now - count.last_s > FORGOTTEN_S:
                    count.number = 0
            wait_s = max(count.next_s for count in counts.values()) - now
            if wait_s > 0.0:
                seconds = math.ceil(wait_s)
                text = message("Too many wrong passwords: try again in {seconds} s.", seconds=seconds)
                raise HTTPException(429, text, {"retry-after": str(seconds)})
            for key, count in counts.items():
                over = count.number + 1 - (TRIES if key == own else TRIES_OF_ALL)
                count.number, count.last_s = count.number + 1, now
                count.next_s = -math.inf if over < 0 else now + min(2.0 ** min(over, 9), LONGEST_WAIT_S)
                self._counts[key] = count
                self._counts.move_to_end(key)
            _shorten(self._counts)
        return tuple(counts)

    def give_back(self, taken: tuple[str, ...]) -> None:
        """The password was right."""
        with self._lock:
            self._counts.pop(taken[0], None)
            for key in taken[1:]:
                if key in self._counts:
                    self._counts[key].number -= 1
                    if self._counts[key].number < TRIES_OF_ALL:
                        self._counts[key].next_s = -math.inf
            self._known[taken[0]] = None
            self._known.move_to_end(taken[0])
            _shorten(self._known)


def _shorten(found: "OrderedDict[str, Any]") -> None:
    while len(found) > MOST_SESSIONS:
        found.popitem(last=False)


def _network(address: str) -> str:
    """An address, or the network of one of IPv6, of which a computer has any number."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address
    return (
        str(found)
        if found.version == 4
        else str(ipaddress.ip_network((address.partition("%")[0], 64), strict=False))
    )


def cookie_name(request: Request) -> str:
    """Name of the cookie of a session: of this port, for browsers keep cookies by the name of the computer alone."""
    return f"{COOKIE}_{request.url.port or 443}"


class Needs:
    """Dependency of a route: the session, which has a permission; for what changes anything, with its token.

    Args:
        permission: what the session has to be allowed; None for routes before the login.
    """

    def __init__(self, permission: Permission | None) -> None:
        self.permission = permission

    async def __call__(self, request: Request) -> Session:
        """The session of a request; in the loop, so that no busy thread holds up a stop.

        Raises:
            HTTPException: 401 without a session of somebody, 403 without permission or with a wrong token.
        """
        access: Access = request.app.state.access
        session = access.find(request.cookies.get(cookie_name(request)))
        if session is None and request.method in SAFE_METHODS and self.permission in {None, "look"}:
            session = access.begin()
            request.state.new_session = session
        if session is None or (self.permission is not None and not session.roles):
            raise HTTPException(401, "log in first")
        if self.permission is not None and not session.may(self.permission):
            raise HTTPException(
                403, f"this needs the permission '{self.permission}', which your role has not"
            )
        if access.is_idle(session) and self.permission not in {None, "look", "stop"}:
            raise HTTPException(401, message("Nobody has worked here for a while: log in again."))
        if request.method not in SAFE_METHODS or "text/html" in request.headers.get("accept", ""):
            access.act(session)
        if request.method not in SAFE_METHODS:
            token = request.headers.get(TOKEN_HEADER, "")
            if not hmac.compare_digest(token.encode(), session.token.encode()):
                raise HTTPException(403, "the token of the page is missing or old: load the page again")
        request.state.session = session
        return session


def log_in_of(users: Path) -> Callable[[str, str, str], bool]:
    """Log in by the accounts of the console: with its tries and audit trail, for those who may operate there.

    Args:
        users: file of users.

    Returns:
        A function of name, password and address: whether this person may operate.

    Raises:
        UsageError: the file has no accounts.
        ConfigError: it cannot be read.
    """
    access = Access(accounts_in(users), trail_of(users.resolve()))

    def log_in(name: str, password: str, address: str) -> bool:
        try:
            session = access.log_in(name, password, address)
        except HTTPException:  # too many tries
            return False
        if session is None:
            return False
        access.end(session)
        return session.may("operate")

    return log_in


def accounts_in(users: Path) -> Accounts:
    """Accounts of a file of users.

    Raises:
        UsageError: the file has no accounts.
        ConfigError: it cannot be read.
    """
    accounts = Accounts(users)
    if not accounts.read():
        raise UsageError(f"--users {users}: has no accounts; `anisoscope user add` makes the first")
    return accounts
