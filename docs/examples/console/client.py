"""Inspect one part at a console: python client.py http://127.0.0.1:8040 RECIPE SERIAL [USER PASSWORD]."""

import json
import sys
from contextlib import closing
from urllib.request import HTTPCookieProcessor, Request, build_opener


class Console:
    """A session at a console."""

    def __init__(self, address, user=None, password=None):
        self.address, self.opener = address, build_opener(HTTPCookieProcessor())
        if user is None:
            self.token = self.get("/api/v1/session")["token"]
        else:
            with self.opener.open(f"{address}/login") as answer:
                page = answer.read().decode()
            self.token = page.partition('name="token" content="')[2].partition('"')[0]
            self.token = self.post("/login", name=user, password=password)["token"]

    def get(self, path):
        with self.opener.open(self.address + path) as answer:
            return json.load(answer)

    def post(self, path, **content):
        headers = {"Content-Type": "application/json", "X-CSRF-Token": self.token}
        with self.opener.open(Request(self.address + path, json.dumps(content).encode(), headers)) as answer:
            return json.load(answer)

    def events(self):
        """Events as (kind, content), from the present state on."""
        kind = ""
        with self.opener.open(f"{self.address}/api/v1/events") as lines:
            for line in lines:
                name, _, text = line.decode().rstrip("\n").partition(": ")
                if name == "event":
                    kind = text
                elif name == "data":
                    yield kind, json.loads(text)


def main(address, recipe, serial, *login):
    console = Console(address, *login)
    console.post("/api/v1/start", recipe=recipe, serial=serial)
    with closing(console.events()) as events:
        for kind, content in events:
            if kind == "progress":
                print(content["doing"])
            elif content["state"] in {"done", "failed"}:
                print(content["verdict"]["verdict"] if content["verdict"] else content["failure"]["text"])
                break
    console.post("/api/v1/release")


if __name__ == "__main__":
    main(*sys.argv[1:])
