"""A real broker for tests, which can be killed, and a client that acts as a hub."""

import json
import subprocess
from pathlib import Path

import paho.mqtt.client as paho

from vb_core.child_processes import free_port, spawn
from vb_testing import TIMEOUT, is_listening, wait_until

PROGRAM = "/usr/sbin/mosquitto"  # Debian's location, which is in the PATH only for root


class Mosquitto:
    """A broker with these lines in its configuration; a kill loses all its retained messages and sessions."""

    def __init__(self, folder, options=("allow_anonymous true",)):
        self.port = free_port()
        self._file = Path(folder) / "mosquitto.conf"
        self._file.write_text("\n".join([f"listener {self.port} 127.0.0.1", "user root", *options]))
        self._process = None
        self.start()

    def start(self):
        self._process = spawn([PROGRAM, "-c", str(self._file)], stderr=subprocess.DEVNULL)
        wait_until(self._listens, "the broker")

    def _listens(self):
        assert self._process.poll() is None, "the broker has ended"
        return is_listening(self.port)

    def kill(self):
        self._process.kill()
        self._process.wait()


class Hub:
    """A hub: keeps the newest message of each topic, and sends commands with QoS 1 as Home Assistant does."""

    def __init__(self, port, setup=lambda client: None):
        self.messages, self.heard = {}, []  # the newest message of each topic; all messages
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        setup(self._client)
        self._client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self._client.on_message = self._on_message
        self._client.reconnect_delay_set(1, 1)
        self._client.connect_async("127.0.0.1", port, 10)
        self._client.loop_start()
        wait_until(self._client.is_connected, "the hub's connection")

    def _on_message(self, _client, _data, message):
        self.messages[message.topic] = message.payload
        self.heard.append((message.topic, message.payload))

    def value(self, topic):
        """Returns the newest JSON value on a topic, or None."""
        return json.loads(self.messages[topic]) if self.messages.get(topic) else None

    def wait(self, topic, condition, awaited, timeout=TIMEOUT):
        wait_until(lambda: self.value(topic) is not None and condition(self.value(topic)), awaited, timeout)
        return self.value(topic)

    def send(self, topic, payload, retain=False, qos=1):
        if not isinstance(payload, (bytes, str)):
            payload = json.dumps(payload)
        return self._client.publish(topic, payload, qos=qos, retain=retain)

    def connected(self):
        return self._client.is_connected()

    def close(self):
        self._client.disconnect()
        self._client.loop_stop()
