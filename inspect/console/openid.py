"""Login by OpenID Connect: the authorization code flow with PKCE, and the roles that a claim gives a person.

Sources: OpenID Connect Core 1.0, section 3.1; OpenID Connect Discovery 1.0; RFC 7636 (PKCE); RFC 9207 (issuer in the
answer). What is sent and how a token is verified is Authlib's and joserfc's.
"""

import hmac
import secrets
import time
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

from fastapi import HTTPException
from pydantic import Field, field_validator

from anisoscope.base.address import is_loopback
from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import ConfigError
from anisoscope.base.language import message
from anisoscope.base.toml_file import LocalPath, Part, read_toml_model
from anisoscope.console.accounts import Role

ALGORITHMS = [f"{kind}{bits}" for kind in ("RS", "PS", "ES") for bits in (256, 384, 512)]
"""Signatures by a key that the provider alone has."""
BEGUN_S, ANSWER_S, LEEWAY_S = 600.0, 10.0, 60
MOST_ANSWER = 1 << 20


def _is_private(address: str) -> bool:
    parts = urlsplit(address)
    return parts.scheme == "https" or (parts.scheme == "http" and is_loopback(parts.hostname or ""))


class Provider(Part):
    """File of an OpenID provider: how it is reached, and which of its claims give which roles.

    Attributes:
        issuer: its address, as its tokens name it.
        client: name under which it knows the console.
        secret: of the client; None for one without (PKCE protects the code in any case).
        name: claim with the name of a person; an ``email`` that the provider calls not verified is none.
        claim: claim with what a person belongs to, a text or a list; dots lead into tables. What the token lacks of
            both is asked for at the provider (userinfo).
        scopes: what is requested.
        authority: certificate of the authority (PEM) that the provider's certificate is of; None takes the known ones.
        roles: role by value of the claim.
    """

    issuer: str
    client: str = Field(min_length=1)
    secret: str | None = None
    name: str = "preferred_username"
    claim: str = "groups"
    scopes: tuple[str, ...] = ("openid", "profile")
    authority: LocalPath | None = None
    roles: dict[str, Role] = Field(min_length=1)

    @field_validator("issuer")
    @classmethod
    def _private(cls, issuer: str) -> str:
        if not _is_private(issuer):
            raise ValueError("takes an address with https://, or one of this computer")
        return issuer


def read_provider(path: Path) -> Provider:
    """The file of a provider.

    Raises:
        ConfigError: it cannot be read, or does not hold what is needed.
    """
    return read_toml_model(path, Provider, error=ConfigError)


@dataclass(frozen=True)
class Begun:
    """A login that waits for the provider's answer."""

    state: str
    nonce: str
    verifier: str
    at_s: float


@dataclass(frozen=True)
class Person:
    """Person who has logged in: name, roles, and the provider's id (``sub``)."""

    name: str
    roles: frozenset[Role]
    subject: str


class OpenId:
    """Logins by a provider.

    Args:
        provider: its file.
        clock: a monotonic clock in seconds.

    Raises:
        ImportError: a package of the extra ``openid`` is missing.
    """

    def __init__(self, provider: Provider, clock: Clock = SYSTEM) -> None:
        from authlib.integrations import requests_client
        from joserfc.errors import JoseError
        from urllib3.exceptions import HTTPError

        self.provider, self._clock = provider, clock
        self.host = urlsplit(provider.issuer).netloc
        self._requests, self._broken = requests_client, HTTPError
        self._forged: tuple[type[Exception], ...] = (JoseError, ValueError, TypeError, KeyError)

    def begin(self, back: str) -> tuple[str, Begun]:
        """Address for the browser, and the state to remember until it is back.

        Args:
            back: address of the console to which the provider sends the browser.

        Raises:
            HTTPException: 502, the provider does not answer, or is another one.
        """
        state, nonce, verifier = (secrets.token_urlsafe(48) for _ in range(3))
        begun = Begun(state, nonce, verifier, self._clock())
        with self._session(back) as session:
            address, _ = session.create_authorization_url(
                self._metadata(session)["authorization_endpoint"],
                state=begun.state,
                nonce=begun.nonce,
                code_verifier=begun.verifier,
            )
        return str(address), begun

    def finish(self, begun: Begun | None, back: str, answer: Mapping[str, str]) -> Person:
        """Person who has logged in, from the provider's answer.

        Args:
            begun: of the browser that brings the answer; None where it has begun no login.
            back: as for `begin`.
            answer: query of the address at which it came back.

        Raises:
            HTTPException: 400 for an answer to nothing, 401 where the provider or the token says no, 403 without a
                role, 502 as for `begin`.
        """
        state = answer.get("state", "").encode()
        if begun is None or not hmac.compare_digest(begun.state.encode(), state):
            raise HTTPException(400, message("This browser has begun no such login: log in again."))
        if self._clock() - begun.at_s > BEGUN_S:
            raise HTTPException(400, message("The login took too long: log in again."))
        if answer.get("iss", self.provider.issuer) != self.provider.issuer:
            raise HTTPException(401, message("The answer is not of {host}.", host=self.host))
        if "code" not in answer:
            why = " ".join(f"{answer.get('error', '')} {answer.get('error_description', '')}".split())[:200]
            raise HTTPException(401, message("{host} refused the login: {why}", host=self.host, why=why))
        with self._session(back) as session:
            metadata = self._metadata(session)
            token = self._token(session, metadata["token_endpoint"], answer["code"], begun.verifier)
            keys = self._fetched(session, metadata["jwks_uri"])
            claims = self._claims(token, keys, begun.nonce)
            if _claim(claims, self.provider.name) is None or _claim(claims, self.provider.claim) is None:
                claims = self._completed(claims, session, metadata)
        return self._person(claims)

    def _completed(
        self,
        claims: Mapping[str, Any],
        session: Any,  # noqa: ANN401 - of the extra
        metadata: Mapping[str, Any],
    ) -> Mapping[str, Any]:
        """The claims of a token, and what the provider says of the same person (OpenID Connect Core 1.0, 5.3)."""
        address = metadata.get("userinfo_endpoint")
        if address is None:
            return claims
        if not _is_private(str(address)):
            raise self._no_answer(ValueError("an address without https"))
        more = self._fetched(session, str(address), withhold_token=False)
        if more.get("sub") != claims["sub"]:
            text = message("The answer of {host} is of another person than its token.", host=self.host)
            raise HTTPException(401, text)
        return {**more, **claims}

    def _session(self, back: str) -> Any:  # noqa: ANN401 - of the extra
        session = self._requests.OAuth2Session(
            self.provider.client,
            self.provider.secret,
            scope=" ".join(self.provider.scopes),
            redirect_uri=back,
            code_challenge_method="S256",
        )
        if self.provider.authority is not None:
            session.verify = str(self.provider.authority)
        for scheme in ("https://", "http://"):
            session.mount(scheme, _bounded())
        return session

    def _fetched(self, session: Any, address: str, *, withhold_token: bool = True) -> dict[str, Any]:  # noqa: ANN401
        try:
            answer = session.request("GET", address, withhold_token=withhold_token, timeout=ANSWER_S)
            answer.raise_for_status()
            return dict(answer.json())
        except (OSError, ValueError, TypeError, self._broken) as problem:  # those of requests are OSError
            raise self._no_answer(problem) from problem

    def _no_answer(self, problem: Exception) -> HTTPException:
        why = type(problem).__name__
        return HTTPException(
            502,
            message("{host} does not answer as an OpenID provider: {why}", host=self.host, why=why),
        )

    def _metadata(self, session: Any) -> dict[str, Any]:  # noqa: ANN401
        address = f"{self.provider.issuer.rstrip('/')}/.well-known/openid-configuration"
        found = self._fetched(session, address)
        if found.get("issuer") != self.provider.issuer:
            other = str(found.get("issuer"))[:200]
            text = message(
                "The provider calls itself {other}, not {issuer}: mend the issuer in the file of --openid.",
                other=other,
                issuer=self.provider.issuer,
            )
            raise HTTPException(502, text)
        places = ("authorization_endpoint", "token_endpoint", "jwks_uri")
        if not all(_is_private(str(found.get(name, ""))) for name in places):
            raise self._no_answer(ValueError("an address without https"))
        return found

    def _token(self, session: Any, address: str, code: str, verifier: str) -> dict[str, Any]:  # noqa: ANN401
        from authlib.integrations.base_client import OAuthError

        try:
            return dict(session.fetch_token(address, code=code, code_verifier=verifier, timeout=ANSWER_S))
        except OAuthError as problem:
            if problem.error == "invalid_grant":
                raise HTTPException(
                    401, message("The code of the login has expired or was used: log in again.")
                ) from problem
            text = message("{host} refused the login: {why}", host=self.host, why=str(problem.error))
            raise HTTPException(401, text) from problem
        except (OSError, ValueError, TypeError, self._broken) as problem:
            raise self._no_answer(problem) from problem

    def _claims(self, token: Mapping[str, Any], keys: Mapping[str, Any], nonce: str) -> Mapping[str, Any]:
        """The claims of a token whose signature, issuer, audience, nonce and time are right."""
        from authlib.oidc.core import CodeIDToken
        from joserfc import jwt
        from joserfc.jwk import KeySet, KeySetSerialization

        provider = self.provider
        try:
            found = jwt.decode(
                token["id_token"],
                KeySet.import_key_set(cast("KeySetSerialization", keys)),
                algorithms=ALGORITHMS,
            )
            claims = CodeIDToken(
                found.claims,
                found.header,
                {
                    "iss": {"essential": True, "value": provider.issuer},
                    "aud": {"essential": True, "value": provider.client},
                },
                {
                    "nonce": nonce,
                    "client_id": provider.client,
                    "access_token": token.get("access_token"),
                },
            )
            claims.validate(leeway=LEEWAY_S)
        except self._forged as problem:
            why = " ".join(str(problem).split())[:200]
            text = message("The token of {host} cannot be trusted: {why}", host=self.host, why=why)
            raise HTTPException(401, text) from problem
        return dict(claims)

    def _person(self, claims: Mapping[str, Any]) -> Person:
        provider, name, subject = self.provider, claims.get(self.provider.name), str(claims["sub"])
        verified = provider.name != "email" or str(claims.get("email_verified", True)).lower() == "true"
        plain = unicodedata.normalize("NFKC", name) if isinstance(name, str) else ""
        name = " ".join(word for word in plain.split(" ") if word)
        if not verified or not 0 < len(name) <= 80 or not name.isprintable():
            text = message(
                "{host} gives no name: its token has no claim {claim} that is one.",
                host=self.host,
                claim=provider.name,
            )
            raise HTTPException(403, text)
        found = _claim(claims, provider.claim)
        values = (
            [str(one) for one in found] if isinstance(found, list) else [str(found)] * (found is not None)
        )
        roles = frozenset(provider.roles[one] for one in values if one in provider.roles)
        if not roles:
            text = message(
                "{name} has no role here: {claim} is {values}, which the file of --openid gives none.",
                name=name,
                claim=provider.claim,
                values=", ".join(values)[:200] or "–",
            )
            raise HTTPException(403, text)
        return Person(name, roles, subject)


def _bounded() -> Any:  # noqa: ANN401 - of the extra
    """Sends requests as usual, and takes answers of a limited size within a time for the whole."""
    from requests import RequestException
    from requests.adapters import HTTPAdapter

    class Bounded(HTTPAdapter):
        def send(self, *args: Any, **options: Any) -> Any:  # noqa: ANN401 - as requests has it
            answer = super().send(*args, **options | {"stream": True})
            found, ends_s = b"", time.monotonic() + ANSWER_S
            try:
                while piece := answer.raw.read1(MOST_ANSWER // 16, decode_content=True):
                    found += piece
                    if len(found) > MOST_ANSWER or time.monotonic() > ends_s:
                        raise RequestException("the answer is too large, or comes too slowly")
            finally:
                answer.close()
            answer._content = found  # noqa: SLF001 - where requests keeps it
            return answer

    return Bounded()


def _claim(claims: Mapping[str, Any], name: str) -> Any:  # noqa: ANN401 - whatever the provider says
    """A claim by its name, or along the dots of it."""
    if name in claims:
        return claims[name]
    found: Any = claims
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found
