"""Who may do what: accounts, sessions in cookies, and the permission that every route names.

Without accounts the console has one user, who may do everything and sits at this computer. With accounts every session
begins without a role, and gets one by name and password.
"""

import hmac
import math
import secrets
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Literal

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
TRIES, TRIES_S = 5, 300.0
SINGLE_USER = "this computer"


@dataclass
class Session:
    """A browser, or a program, and who uses it; no roles before the login."""

    id: str
    token: str
    name: str = ""
    roles: frozenset[Role] = frozenset()
    seen_s: float = 0.0
    ends_s: float = math.inf
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
    """

    def __init__(
        self,
        accounts: Accounts | None,
        trail: Trail,
        clock: Clock = SYSTEM,
        *,
        secure: bool = False,
        openid: OpenId | None = None,
    ) -> None:
        self.accounts, self.trail, self.secure, self.openid = accounts, trail, secure, openid
        self._clock = clock
        self._lock = threading.Lock()
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._failures: dict[str, deque[float]] = {}
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

    def holds(self, session: Session) -> bool:
        """Whether a session is still one, for what it began and has not ended."""
        with self._lock:
            return self._sessions.get(session.id) is session and not self._is_over(session)

    def begin(self) -> Session:
        """A new session; the one unused for longest makes room for it."""
        session = Session(secrets.token_urlsafe(32), secrets.token_urlsafe(32), seen_s=self._clock())
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
            HTTPException: 429 after five wrong passwords in five minutes, for this name or from this address.
        """
        assert self.accounts is not None
        keys = (f"name {name[:80]}", f"address {address}")
        if any(len(self._recent(key)) >= TRIES for key in keys):
            raise HTTPException(429, "too many wrong passwords: try again in five minutes")
        with self._checking:
            account = self.accounts.check(name, password)
        if account is None:
            with self._lock:
                for key in keys:
                    self._failures.setdefault(key, deque(maxlen=TRIES)).append(self._clock())
                while len(self._failures) > MOST_SESSIONS:
                    self._failures.pop(next(iter(self._failures)))
            self.trail.add(name[:80], "login refused", address=address)
            return None
        self.trail.add(account.name, "login", address=address)
        session = self.begin()
        session.name, session.roles, session.account = account.name, frozenset({account.role}), account
        return session

    def admit(self, person: Person, address: str) -> Session:
        """A new session of a person whom the OpenID provider knows.

        Raises:
            HTTPException: 403, an account has this name, and the audit trail could not tell them apart.
        """
        assert self.accounts is not None
        assert self.openid is not None
        if person.name in self.accounts.read():
            text = message("There is an account {name} here: log in with its password.", name=person.name)
            raise HTTPException(403, text)
        issuer = self.openid.provider.issuer
        self.trail.add(person.name, "login", address=address, issuer=issuer, subject=person.subject)
        session = self.begin()
        session.name, session.roles = person.name, person.roles
        session.ends_s = self._clock() + SESSION_S  # then the provider says again who may
        return session

    def _recent(self, key: str) -> list[float]:
        with self._lock:
            return [at for at in self._failures.get(key, ()) if self._clock() - at < TRIES_S]


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
