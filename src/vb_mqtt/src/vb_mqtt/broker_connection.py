"""The connection to the MQTT broker, which is restored automatically. No ROS.

States are sent with QoS 0, and after each new connection the newest ones are sent again. Thus a lost message is
replaced, and an old one is never sent after a newer one. The session is clean, so that the broker queues no requests
while this client is disconnected: nobody would expect them to be carried out later.
"""

from __future__ import annotations

import ssl
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Optional, Tuple
from urllib.parse import urlsplit

import paho.mqtt.client as paho
import yaml

from vb_core import files
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param

KEEPALIVE = 10  # [s] if broker or network fail without a sign, this is noticed after one and a half times as long
_RETRIES = (1, 10)  # [s] shortest and longest time between two attempts to connect


@dataclass(frozen=True)
class Connection(Parameters):
    """The settings of the connection to the broker, from a file that only its owner can read."""

    username: str = param("")
    password: str = param("")
    port: int = param(0, "", low=0, high=65535)  # 0: the default
    tls: bool = param(False)
    ca_file: str = param("")  # certificate of the CA that signed the broker's certificate; "" for the system's CAs


def read_connection(path: Path) -> Connection:
    """Reads a YAML file, and makes it readable by its owner only. If there is no file, the default settings apply.

    Raises CodedError "mqtt_file_bad", "bad_parameter" or "file_not_private".
    """
    try:
        if not path.exists():
            return Connection()
        files.restrict_to_owner(path)
        return Connection.from_mapping(yaml.safe_load(path.read_text(encoding="utf-8")), str(path))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__  # the error's text may contain the password
        raise CodedError("mqtt_file_bad", file=path, reason=reason) from None


def _split_address(address: str) -> Tuple[str, Optional[int]]:
    try:
        parts = urlsplit(f"//{address}")
        if parts.hostname and parts.netloc == address:  # false if the address has a scheme or a path
            return parts.hostname, parts.port
    except ValueError:
        pass
    raise ParameterError("broker", f"expected HOST or HOST:PORT, an IPv6 address in brackets, got '{address}'")


class MqttClient:
    """A client of a broker. One separate thread calls all callbacks.

    Args:
        address: HOST or HOST:PORT; an IPv6 address is in brackets.
        client: the client's id. It is always the same, so that the broker ends an earlier connection first.
        will: topic and payload of a retained message that the broker publishes when this client is gone.
        subscriptions: callbacks (topic, payload, retained) by topic filter, with QoS 1.
        on_fault: called with the exception if a callback raised one, which is a fault of the program.

    Raises:
        CodedError: "bad_parameter" for a malformed address; "mqtt_file_bad" if the CA file cannot be used.
    """

    def __init__(
        self,
        address: str,
        connection: Connection,
        client: str,
        will: Tuple[str, bytes],
        subscriptions: Dict[str, Callable[[str, bytes, bool], None]],
        on_fault: Callable[[Exception], None],
    ) -> None:
        host, port = _split_address(address)
        port = port or connection.port or (8883 if connection.tls else 1883)
        self.address = f"{host}:{port}"
        self.trouble = ""  # why the broker last refused a connection or subscription, or ""
        self._states: Dict[str, bytes] = {}  # the newest retained message of each topic
        self.connected = False  # whether the broker has accepted this client
        self._lock = threading.Lock()
        self._will = will
        self._subscriptions = subscriptions
        self._on_fault = on_fault
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id=client, clean_session=True)
        self._client.will_set(*will, qos=1, retain=True)
        if connection.username:
            self._client.username_pw_set(connection.username, connection.password or None)
        if connection.tls:
            self._client.tls_set_context(_make_tls_context(connection.ca_file))
        self._client.reconnect_delay_set(*_RETRIES)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_subscribe = self._on_subscribe
        for topics, callback in subscriptions.items():
            self._client.message_callback_add(topics, self._make_receiver(callback))
        self._client.connect_async(host, port, KEEPALIVE)

    def start(self) -> None:
        """Connects, and reconnects whenever the connection is lost."""
        self._client.loop_start()

    def put(self, topic: str, payload: bytes) -> None:
        """Sets a topic's retained message, now or once connected. An empty payload deletes it, but only if connected."""
        with self._lock:
            if payload and self._states.get(topic) == payload:
                return
            self._states[topic] = payload
            if not payload:
                del self._states[topic]
            if self.connected:
                self._client.publish(topic, payload, qos=0, retain=True)

    def send(self, topic: str, payload: bytes) -> None:
        """Sends a message that is not retained. Without a connection it is dropped."""
        if self.connected:
            self._client.publish(topic, payload, qos=0)

    def close(self) -> None:
        """Publishes the will and disconnects."""
        if self.connected:
            self._client.publish(*self._will, qos=1, retain=True).wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()

    # ------------------------------------------------------------------ callbacks
    def _on_connect(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self.trouble = str(reason)
            return
        # subscribes first, because a hub may send requests as soon as it sees that this client is online
        client.subscribe([(topics, 1) for topics in self._subscriptions])
        with self._lock:
            self.connected = True
            self.trouble = ""
            for topic, payload in self._states.items():
                client.publish(topic, payload, qos=0, retain=True)

    def _on_disconnect(self, *_arguments: Any) -> None:
        with self._lock:
            self.connected = False

    def _on_subscribe(self, _client: Any, _data: Any, _id: int, reasons: Any, _properties: Any) -> None:
        self.trouble = next((str(reason) for reason in reasons if reason.is_failure), "")

    def _make_receiver(self, callback: Callable[[str, bytes, bool], None]) -> Callable[..., None]:
        def receive(_client: Any, _data: Any, message: Any) -> None:
            try:
                callback(message.topic, bytes(message.payload), bool(message.retain))
            except Exception as error:  # must not end this thread, which receives all messages
                self._on_fault(error)

        return receive


def _make_tls_context(ca_file: str) -> ssl.SSLContext:
    try:
        path = str(Path(ca_file).expanduser()) if ca_file else None
        return ssl.create_default_context(cafile=path)
    except (OSError, ssl.SSLError) as error:
        raise CodedError("mqtt_file_bad", file=ca_file, reason=error.strerror or error) from None
