"""The voice recogniser: spoken words for the whole, and its network's file."""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from vb_core.errors import CodedError, ParameterError
from vb_voice_wizard.recognizer import ALWAYS_UNCLEAR, CommandNetwork, CommandRecognizer, RecognizerParams
from vb_voice_wizard.voice.speech_model import END, FEATURES, START, Beginnings, SpeechModel

sys.path.insert(0, str(Path(__file__).parent))
from speech import RATE, room_noise, say, tone  # noqa: E402

COMMANDS = {
    "define_border": ("define border", "en-us"),
    "define_seed": ("define seed", "en-gb"),
    "guide_robot": ("guide robot", "en-us+f2"),
    "save": ("save", "en-gb+m3"),
    "cancel": ("cancel", "en-us+f4"),
    "stop": ("stop", "en-us"),
    "resume": ("resume", "en-gb"),
    "undo": ("undo", "en-us+m3"),
    "redo": ("redo", "en-gb+f2"),
}


@pytest.fixture(scope="module")
def recognizer():
    return CommandRecognizer()


def test_commands_are_recognised_most_of_the_time(recognizer):
    """One voice in one noise each: how often is bench/voice.py's matter."""
    issues = {command: recognizer.examine(say(*spoken))[0] for command, spoken in COMMANDS.items()}
    assert all(issue.command in (None, command) for command, issue in issues.items()), issues
    heard = [issue for command, issue in issues.items() if issue.command == command]
    assert len(heard) >= 6, issues
    assert all(issue.best == issue.command and issue.reason == "ok" for issue in heard)
    assert all(issue.confidence >= recognizer.threshold for issue in heard)


def test_what_was_made_of_it_can_be_seen(recognizer):
    (issue,) = recognizer.examine(say("has anyone seen my glasses"))
    assert issue.command is None and issue.best and issue.confidence < recognizer.threshold
    assert issue.reason == "unlike_a_command"
    long = say("this sentence goes on and on and on for much longer than any command could ever take")
    assert [issue.reason for issue in recognizer.examine(long)] == ["too_long"]


@pytest.mark.parametrize("text", ["saving", "defined border", "cancelled", "undone", "council", "stopped", "resumed"])
def test_near_misses_are_never_acted_on_unasked(recognizer, text):
    for issue in recognizer.examine(say(text)):
        assert issue.command in (None, "stop") or issue.unclear, f"{text} is surely {issue.command}"


def test_one_word_never_lets_robots_drive_again(recognizer):
    for voice in ("en-us", "en-gb", "en-us+f2"):
        for issue in recognizer.examine(say("resume", voice, snr_db=25.0)):
            assert issue.command is None or issue.unclear
    assert "resume" in ALWAYS_UNCLEAR


@pytest.mark.parametrize("text", ["what is for dinner tonight", "good afternoon", "the robot got stuck under the sofa"])
def test_other_sentences_are_not_commands(recognizer, text):
    assert recognizer.recognize(say(text, "en-gb+f2")) is None


def test_noise_beeps_and_nothing_are_no_commands(recognizer):
    quiet = np.zeros(RATE, dtype=np.int16)
    assert recognizer.examine(quiet) == []
    assert recognizer.recognize(np.zeros(0, dtype=np.int16)) is None
    assert recognizer.recognize(room_noise(3 * RATE, 1000).astype(np.int16)) is None
    for hertz in (440, 880, 1760):
        assert recognizer.recognize(np.concatenate([quiet, tone(hertz, 0.3), quiet])) is None


def test_every_beginning_is_asked_about_once_and_read_again_from_a_file():
    beginnings = Beginnings([(5, 7), (5, 8, 9), (6,)])
    np.testing.assert_array_equal(beginnings.texts, [[START, 5, 7, END], [START, 5, 8, 9], [START, 6, END, END]])
    asked = [tuple(beginnings.texts[row, 1 : 1 + column]) for row, column in zip(*beginnings.at)]
    assert sorted(asked) == [(), (5,), (5, 7), (5, 8), (5, 8, 9), (6,)] and asked[0] == ()
    np.testing.assert_array_equal(Beginnings.read(beginnings.texts).at, beginnings.at)


def test_the_speech_model_tells_what_was_said_not_how_loud(recognizer):
    model, pcm, beginnings = recognizer._model, say("define seed"), recognizer._network.beginnings
    moments = model.moments(pcm)
    assert moments.shape[1] == FEATURES
    told = model.continuations(moments, beginnings)
    assert len(told) == len(beginnings.at[0]) and told.max() <= 0.0
    soft = model.continuations(model.moments((pcm // 8).astype(np.int16)), beginnings)
    assert np.corrcoef(told.ravel(), soft.ravel())[0, 1] > 0.95
    # nothing that it is asked afterwards changes what it says after the empty beginning
    alone = model.continuations(moments, Beginnings([beginnings.texts[0, 1:2]]))
    assert np.corrcoef(alone[0], told[0])[0, 1] > 0.95
    assert np.isfinite(model.continuations(model.moments(np.zeros(RATE // 5, np.int16)), beginnings)).all()


def test_only_sound_of_the_expected_kind(recognizer):
    for wrong in (np.zeros(RATE), np.zeros((RATE, 2), dtype=np.int16)):
        with pytest.raises(ValueError, match="int16"):
            recognizer.recognize(wrong)


def write_network(path, commands=("save", "cancel")):
    """A network that finds "save" whatever it hears."""
    np.savez(str(path), commands=np.array(commands), texts=Beginnings([(5,)]).texts, tokens=np.array([[3, 4], [5, 6]]), threshold=0.5,
             sure=0.99, weights0=np.zeros((4, 3), np.float16), bias0=np.array([0.0, 3.0, 0.0]))
    return path


def test_another_network_by_configuration(tmp_path):
    path = write_network(tmp_path / "mine.npz")
    assert CommandRecognizer(RecognizerParams(model=str(path))).recognize(say("define border")) == "save"
    surer = CommandRecognizer(RecognizerParams(model=str(path), threshold=0.95))
    assert surer.recognize(say("define border")) is None
    chance = CommandNetwork(path).probabilities(np.zeros((2, 10), np.float32))
    assert chance.shape == (2,) and 0.0 < chance.sum() < 1.0


def test_bad_files_are_named(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    for path in (tmp_path / "none.npz", tmp_path / "bad.npz", write_network(tmp_path / "dance.npz", ("dance", "save"))):
        with pytest.raises(ParameterError) as caught:
            CommandRecognizer(RecognizerParams(model=str(path)))
        assert caught.value.key == "model" and path.name in caught.value.message
    (tmp_path / "encoder_model.ort").write_bytes(b"nothing")
    for folder in (tmp_path / "none", tmp_path):
        with pytest.raises(CodedError) as caught:
            SpeechModel(folder)
        assert caught.value.code == "no_speech_model" and "encoder_model.ort" in str(caught.value.values["file"])
