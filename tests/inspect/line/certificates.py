"""Certificates of applications of OPC UA, made as most programs make them: not for signing others."""

from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

NOW = datetime.now(UTC)
DAY = timedelta(days=1)
KEY_USES = ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment")
ALL_USES = (*KEY_USES, "key_agreement", "key_cert_sign", "crl_sign", "encipher_only", "decipher_only")


def new_key():
    return rsa.generate_private_key(65537, 2048)


def certificate(
    key, uri, name, *, first=NOW - DAY, last=NOW + 365 * DAY, use=ExtendedKeyUsageOID.CLIENT_AUTH
):
    """Without a URI it has no subjectAltName."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    uses = x509.KeyUsage(**{one: one in KEY_USES for one in ALL_USES})
    made = (
        x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number(), first, last)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(uses, critical=True)
        .add_extension(x509.ExtendedKeyUsage([use]), critical=False)
    )
    if uri:
        names = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri), x509.DNSName("plc")])
        made = made.add_extension(names, critical=False)
    return made.sign(key, hashes.SHA256())


def der(found):
    return found.public_bytes(Encoding.DER)


def write_pair(folder, made, key):
    """Files of a certificate (DER) and its key (PEM), which its owner alone reads."""
    folder.mkdir(exist_ok=True)
    own, secret = folder / "certificate.der", folder / "key.pem"
    own.write_bytes(der(made))
    secret.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    secret.chmod(0o600)
    return own, secret
