"""An object store: moto's server with authentication enforced. It is somebody else's, but no full S3 server."""

import json

import pytest


@pytest.fixture(scope="session")
def server():
    """The address of an object store that refuses wrong credentials, and a key pair that it takes."""
    from moto.server import ThreadedMotoServer

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("INITIAL_NO_AUTH_ACTION_COUNT", "3")
        import boto3
        import moto.settings

        patch.setattr(moto.settings, "INITIAL_NO_AUTH_ACTION_COUNT", 3.0)
        started = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        started.start()
        address = "http://{}:{}".format(*started.get_host_and_port())
        how = {"endpoint_url": address, "region_name": "us-east-1"}
        first = {"aws_access_key_id": "first", "aws_secret_access_key": "first"}
        iam = boto3.client("iam", **how, **first)
        iam.create_user(UserName="station")
        key = iam.create_access_key(UserName="station")["AccessKey"]
        policy = {
            "Version": "2012-10-17",
            "Statement": [{"Effect": "Allow", "Action": "s3:*", "Resource": "*"}],
        }
        iam.put_user_policy(UserName="station", PolicyName="all", PolicyDocument=json.dumps(policy))
        keys = {"aws_access_key_id": key["AccessKeyId"], "aws_secret_access_key": key["SecretAccessKey"]}
        boto3.client("s3", **how, **keys).create_bucket(Bucket="inspections")
        yield address, keys
        started.stop()


@pytest.fixture
def s3(server, monkeypatch):
    address, keys = server
    for name, value in keys.items():
        monkeypatch.setenv(name.upper(), value)
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    return lambda path="line-2", at=address: f"s3://inspections/{path}?endpoint={at}"


@pytest.fixture
def database(postgresql_programs, postgresql_server):
    """The URL of a database of its own on a server of PostgreSQL."""
    with postgresql_programs.database(postgresql_server) as url:
        yield url
