"""pysparkplug reads an edge node, in an environment of its own: python pysparkplug_reader.py PORT.

It needs paho-mqtt 1. A line of JSON for each message, until the death of the node; the first line says that it listens.
"""

import json
import queue
import sys

import pysparkplug

heard: "queue.Queue[pysparkplug.Message]" = queue.Queue()
client = pysparkplug.Client()
topic = pysparkplug.Topic(group_id="+", message_type="+", edge_node_id="+")
device = pysparkplug.Topic(group_id="+", message_type="+", edge_node_id="+", device_id="+")
for one in (topic, device):
    client.subscribe(one, pysparkplug.QoS.AT_MOST_ONCE, lambda _, message: heard.put(message))
subscribed = queue.Queue()
client._client.on_subscribe = lambda *_: subscribed.put(1)  # noqa: SLF001 - it says nowhere else when it listens
client.connect("127.0.0.1", port=int(sys.argv[1]))
for _ in (topic, device):
    subscribed.get(timeout=60)
print("listening", flush=True)
kind = ""
while kind != "NDEATH":
    message = heard.get(timeout=60)
    kind = message.topic.message_type.name
    payload = message.payload
    found = {
        "kind": kind,
        "seq": getattr(payload, "seq", None),
        "metrics": {
            one.name: None if one.is_null else str(one.value) for one in getattr(payload, "metrics", ())
        },
    }
    print(json.dumps(found), flush=True)
client.disconnect()
