from pathlib import Path

import pytest

from vb_core.errors import CodedError
from vb_evaluation.demonstration import demo

TOP = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    "arguments, word",
    [
        (["--scenario", "garden"], "SCENARIO"),
        (["--method", "magic"], "METHOD"),
        (["--seed", "one"], "SEED"),
        (["--world", "/nowhere/world.yaml"], "/nowhere/world.yaml"),
    ],
)
def test_a_wrong_argument_is_one_line_and_status_2(arguments, word, capfd):
    with pytest.raises(CodedError) as caught:
        demo.parse(arguments, TOP)
    assert word in str(caught.value)
    assert demo.main(arguments, TOP) == 2
    text = capfd.readouterr().err
    assert word in text and text.count("\n") == 1 and "Traceback" not in text


@pytest.mark.parametrize(
    "text, key",
    [
        ("robots: []", "robots"),
        ("rooms: {}", "rooms"),
        ("robots: [{name: a}]\nroom: {size: [8.0, -5.0]}", "room/size"),
        ("robots: [{name: a}]\ncameras: [{name: c, heigth: 2}]", "cameras[0]/heigth"),
        ("robots: [{name: a}]\nscenarios: {carpet: {closed: true}}", "scenarios/carpet/border"),
        ("robots: [{name: a", "line 1"),
        ("just text", "world"),
    ],
)
def test_a_bad_world_names_the_key(text, key, tmp_path, capfd):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    assert demo.main(["--world", str(path)], TOP) == 2
    message = capfd.readouterr().err
    assert key in message and message.count("\n") == 1
