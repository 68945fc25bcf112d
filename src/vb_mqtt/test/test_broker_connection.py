"""The connection to a real broker: it comes back with the newest states, over TLS and with a password."""

import os

import pytest
from mosquitto import PROGRAM, Hub, Mosquitto
from refusals import refused
from vb_core.errors import CodedError
from vb_mqtt.broker_connection import MqttClient, Connection, read_connection
from vb_testing import run_command, wait_until

pytestmark = pytest.mark.skipif(not os.path.exists(PROGRAM), reason="mosquitto is not installed")
WILL = ("lab/availability", b"offline")
ADDRESSES = {"hub": "hub:1883", "hub:1884": "hub:1884", "[fd00::5]": "fd00::5:1883", "[fd00::5]:1884": "fd00::5:1884"}


def connect(port, connection=None, received=None, faults=None):
    def store(topic, payload, retained):
        if payload == b"raise":
            raise ValueError("a fault")
        received.append((topic, payload, retained))

    on_fault = print if faults is None else faults.append
    handlers = {"lab/command": store}
    broker = MqttClient(f"127.0.0.1:{port}", connection or Connection(), "lab", WILL, handlers, on_fault)
    broker.put(WILL[0], b"online")
    broker.start()
    return broker


@pytest.fixture
def server(tmp_path):
    server = Mosquitto(tmp_path)
    yield server
    server.kill()


def wait_for(hub, topic, payload):
    wait_until(lambda: hub.messages.get(topic) == payload, f"{payload} on {topic}")


def test_a_restarted_broker_gets_only_the_newest_states(server):
    client, hub = connect(server.port), Hub(server.port)
    client.put("lab/state", b"old")
    wait_for(hub, "lab/state", b"old")
    client.send("lab/answer", b"old")
    wait_for(hub, "lab/answer", b"old")
    server.kill()
    wait_until(lambda: not client.connected, "the loss to be noticed")
    for number in range(50):
        client.put("lab/state", b"%d" % number)
    client.put("lab/gone", b"x")
    client.put("lab/gone", b"")
    client.send("lab/answer", b"lost")
    hub.messages.clear()
    del hub.heard[:]
    server.start()
    wait_for(hub, "lab/state", b"49")
    wait_for(hub, WILL[0], b"online")
    client.send("lab/answer", b"new")
    wait_for(hub, "lab/answer", b"new")
    topics = {"lab/state", "lab/answer", "lab/gone"}
    assert {message for message in hub.heard if message[0] in topics} == {("lab/state", b"49"), ("lab/answer", b"new")}
    client.close()
    wait_for(hub, WILL[0], b"offline")  # the hub learns at once that the client has ended
    hub.close()


def test_retained_commands_are_marked_and_faults_reported(server):
    hub = Hub(server.port)
    hub.send("lab/command", b"kept", retain=True).wait_for_publish(5.0)
    received, faults = [], []
    client = connect(server.port, received=received, faults=faults)
    wait_until(lambda: received == [("lab/command", b"kept", True)], "the retained command")
    hub.send("lab/command", b"raise")
    hub.send("lab/command", b"new")
    wait_until(lambda: received[1:] == [("lab/command", b"new", False)], "the command after the fault")
    assert [str(fault) for fault in faults] == ["a fault"]
    hub.close()
    client.close()


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    """Returns the folder of a temporary CA with a broker's certificate for 127.0.0.1, and of another CA."""
    folder = tmp_path_factory.mktemp("authority")
    key = "openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
    for name in ("ca", "other"):
        run_command(*f"{key} -x509 -subj /CN={name} -keyout {name}.key -out {name}.crt".split(), cwd=folder, check=True)
    run_command(*f"{key} -subj /CN=broker -keyout b.key -out b.csr".split(), cwd=folder, check=True)
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1")
    signed = "openssl x509 -req -in b.csr -CA ca.crt -CAkey ca.key -CAcreateserial -extfile names -out b.crt"
    run_command(*signed.split(), cwd=folder, check=True)
    return folder


@pytest.fixture
def guarded_server(tmp_path, authority):
    """A broker with TLS that requires a password."""
    passwords = tmp_path / "passwords"
    run_command("mosquitto_passwd", "-b", "-c", passwords, "home", "secret", check=True)
    files = [f"{kind} {authority / name}" for kind, name in (("certfile", "b.crt"), ("keyfile", "b.key"))]
    server = Mosquitto(tmp_path, ["allow_anonymous false", f"password_file {passwords}", *files])
    yield server
    server.kill()


def test_the_connection_can_use_tls_and_a_password(guarded_server, authority):
    credentials = {"tls": True, "ca_file": str(authority / "ca.crt"), "username": "home"}
    client = connect(guarded_server.port, Connection(password="secret", **credentials))

    def log_in(hub_client):
        hub_client.tls_set(credentials["ca_file"])
        hub_client.username_pw_set("home", "secret")

    hub = Hub(guarded_server.port, setup=log_in)
    wait_for(hub, WILL[0], b"online")
    hub.close()
    client.close()
    rejected_client = connect(guarded_server.port, Connection(password="wrong", **credentials))
    wait_until(lambda: rejected_client.trouble, "the refusal")
    assert "authori" in rejected_client.trouble.lower()
    assert not rejected_client.connected
    rejected_client.close()


@pytest.mark.parametrize("host, ca_file", [("127.0.0.1", "other.crt"), ("127.0.0.1", ""), ("localhost", "ca.crt")])
def test_an_untrusted_broker_gets_no_password(guarded_server, authority, host, ca_file):
    failures = []
    ca_path = str(authority / ca_file) if ca_file else ""
    connection = Connection(username="home", password="secret", tls=True, ca_file=ca_path)
    client = MqttClient(f"{host}:{guarded_server.port}", connection, "lab", WILL, {}, failures.append)
    client._client.on_connect_fail = lambda *_: failures.append(True)
    client.start()
    wait_until(lambda: len(failures) > 1, "two failures")
    assert not client.connected
    client.close()


def test_only_its_owner_can_read_the_password_file(tmp_path):
    path = tmp_path / "mqtt.yaml"
    assert read_connection(path) == Connection()
    path.write_text("username: home\npassword: secret\ntls: true\n")
    path.chmod(0o640)
    assert read_connection(path) == Connection(username="home", password="secret", tls=True)
    assert path.stat().st_mode & 0o077 == 0
    for text, code in (("secret: x", "bad_parameter"), ("port: high", "bad_parameter"), ("a: [", "mqtt_file_bad")):
        path.write_text(text)
        with refused(code):
            read_connection(path)
    path.write_text("password: [secret")
    with pytest.raises(CodedError) as caught:
        read_connection(path)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("given, address", ADDRESSES.items())
def test_addresses_with_and_without_a_port_are_read(given, address):
    assert MqttClient(given, Connection(), "lab", WILL, {}, print).address == address


@pytest.mark.parametrize("given", ["mqtt://hub:1883", "hub:port", "hub:99999", "fd00::5", "[fd00::5", ""])
def test_other_addresses_are_refused(given):
    with refused("bad_parameter"):
        MqttClient(given, Connection(), "lab", WILL, {}, print)
