"""Signatures of statements, the keys that make them, and the keys that count."""

import base64
import json
from datetime import UTC, datetime, timedelta

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from anisoscope.base import plugins, signature
from anisoscope.base.errors import ConfigError, UsageError
from anisoscope.base.signature import Trust, TrustedKey, key_id, make_key, read_signed, read_trust, signed


@pytest.fixture
def key(tmp_path):
    return make_key(tmp_path / "keys" / "rig.pem")


def entry(key, **changes):
    return TrustedKey(station="rig 1", public=base64.b64encode(key.public).decode(), **changes)


def test_an_envelope_is_what_another_reader_of_the_standard_verifies(key):
    """DSSE 1.0: the signature is over ``DSSEv1``, the lengths, the type and the payload."""
    envelope = json.loads(signed("record", {"serial": "ü 1"}, key))
    payload, kind = base64.b64decode(envelope["payload"]), envelope["payloadType"]
    said = f"DSSEv1 {len(kind)} {kind} {len(payload)} ".encode() + payload
    Ed25519PublicKey.from_public_bytes(key.public).verify(
        base64.b64decode(envelope["signatures"][0]["sig"]), said
    )
    found = read_signed("record", json.dumps(envelope))
    assert (found.content["serial"], found.public, found.key) == ("ü 1", key.public, key_id(key.public))
    assert abs(datetime.now(UTC) - found.signed_at) < timedelta(days=1)


def test_any_changed_letter_of_an_envelope_is_refused(key):
    envelope = signed("record", {"serial": "A1"}, key)
    hint = range(envelope.index("keyid"), envelope.index('"sig"'))  # the short name of the key is not signed
    for place in range(0, len(envelope), 7):
        changed = envelope[:place] + chr(ord(envelope[place]) ^ 1) + envelope[place + 1 :]
        if place not in hint:
            with pytest.raises(ValueError) as caught:
                read_signed("record", changed)
            assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", "[" * 5000, '{"payloadType": 1}', "x" * (2 << 20)])
def test_what_is_no_envelope_is_one_line(text):
    with pytest.raises(ValueError) as caught:
        read_signed("record", text)
    assert "\n" not in str(caught.value)


def test_a_signature_of_one_kind_never_passes_for_another(key):
    with pytest.raises(ValueError, match="no signature of a head"):
        read_signed("head", signed("record", {}, key))


def test_a_key_counts_by_the_trust_file(key, tmp_path):
    found = read_signed("record", signed("record", {}, key))
    hour = timedelta(hours=1)
    for changes, says in (
        ({}, None),
        ({"since": found.signed_at - hour, "until": found.signed_at + hour}, None),
        ({"since": found.signed_at + hour}, "signed before"),
        ({"until": found.signed_at - hour}, "signed later"),
        ({"revoked": "laptop stolen"}, "is revoked: laptop stolen"),
    ):
        why = Trust(schema=1, keys=(entry(key, **changes),)).distrust(found)
        assert why is None if says is None else says in why, changes
    other = make_key(tmp_path / "other.pem")
    assert "not among the trusted" in Trust(schema=1, keys=(entry(other),)).distrust(found)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("schema = 1\n[[keys]]\nstation = 'a'\npublic = 'abc'\n", "public"),
        ("schema = 1\n[[keys]]\npublic = 'abc'\n", "missing"),
        ("schema = 2\n", "schema"),
        ("a = " + "[" * 100, "nested more than 32 deep|not valid TOML"),
    ],
)
def test_a_trust_file_that_is_none_is_one_line(tmp_path, text, says):
    path = tmp_path / "keys.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says) as caught:
        read_trust(path)
    assert "\n" not in str(caught.value)


def test_a_private_key_is_its_owners_alone(key, tmp_path):
    path = tmp_path / "keys" / "rig.pem"
    assert path.stat().st_mode & 0o777 == 0o600
    assert signature.opened_key(str(path)).public == signature.opened_key(f"file:{path}").public == key.public
    with pytest.raises(UsageError, match="never replaced"):
        make_key(path)
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="chmod 600"):
        signature.opened_key(str(path))


def test_keys_that_cannot_be_used_are_one_line(tmp_path):
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    (tmp_path / "text.pem").write_text("no key")
    other = ec.generate_private_key(ec.SECP256R1())
    (tmp_path / "ec.pem").write_bytes(other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    for name, says in (
        ("none.pem", "anisoscope key new"),
        ("text.pem", "no private key"),
        ("ec.pem", "no Ed25519"),
    ):
        path = tmp_path / name
        if path.exists():
            path.chmod(0o600)
        with pytest.raises(ConfigError, match=says):
            signature.opened_key(str(path))
    with pytest.raises(ConfigError, match="no store of signing keys 'vault'"):
        signature.opened_key("vault:rig-1")


def test_a_store_of_keys_is_an_entry_point(key, monkeypatch):
    class Vault:
        def __init__(self, rest):
            assert rest == "slot/7"
            self.public, self.sign = key.public, key.sign

    class Entry:
        def load(self):
            return Vault

    monkeypatch.setattr(plugins, "installed", lambda group: {"vault": Entry()})
    monkeypatch.setattr(plugins, "_rivals", lambda *_: ())
    monkeypatch.setenv(signature.VARIABLE, "vault:slot/7")
    signer = signature.signer_in_use()
    assert read_signed("head", signed("head", {"n": 1}, signer)).public == key.public


def test_the_environment_has_precedence_and_none_is_none(key, tmp_path, monkeypatch):
    monkeypatch.setattr(signature, "_chosen", None)
    monkeypatch.delenv(signature.VARIABLE, raising=False)
    assert signature.signer_in_use() is None
    signature.use_key(str(tmp_path / "keys" / "rig.pem"))
    assert signature.signer_in_use().public == key.public
    monkeypatch.setenv(signature.VARIABLE, "none")
    assert signature.signer_in_use() is None
