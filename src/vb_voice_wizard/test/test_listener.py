"""From samples to commands in one stream, beside our own sounds; spoken by espeak-ng."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

from vb_core.sounds import SOUNDS, Note, Tones
from vb_voice_wizard.recognizer import CommandRecognizer, RecognitionResult
from vb_voice_wizard.voice.listener import CommandListener, Heard
from vb_voice_wizard.voice_commands_node import VoiceCommandsNode

from speech import RATE, say

PIECE = RATE // 20
BEGAN = 1000.0  # [s] of the clock when the stream begins


@pytest.fixture(scope="module")
def recognizer():
    return CommandRecognizer()


def listen(listener, pcm, sounds=()):
    """Streams sound; our own sounds, (name, [s] from the stream's beginning), are told when they begin."""
    heard, waiting = [], sorted(sounds, key=lambda sound: sound[1])
    for at in range(0, len(pcm), PIECE):
        while waiting and waiting[0][1] * RATE < at + PIECE:
            name, when = waiting.pop(0)
            listener.play(name, BEGAN + when)
        heard += listener.push(pcm[at : at + PIECE], BEGAN + (at + PIECE) / RATE)
    return heard


def test_times_are_when_it_was_said(recognizer):
    pcm = np.concatenate([np.zeros(2 * RATE, np.int16), say("stop", pause=0.6), np.zeros(RATE, np.int16)])
    (heard,) = listen(CommandListener(recognizer), pcm)
    assert heard.result.command == "stop"
    assert heard.start == pytest.approx(BEGAN + 2.6, abs=0.15) and 0.2 < heard.end - heard.start < 0.8


@pytest.mark.parametrize("sound", ["error", "success", "stopped", "recognized"])
def test_stop_counts_whenever_a_sound_of_ours_plays(recognizer, sound):
    pcm = np.concatenate([say("stop", pause=1.0), np.zeros(RATE, np.int16)])
    for when in np.arange(0.0, 2.6, 0.2):
        assert [one.result.command for one in listen(CommandListener(recognizer), pcm, [(sound, when)])] == ["stop"]


def test_another_command_counts_unless_it_lies_within_a_sound_of_ours(recognizer, monkeypatch):
    monkeypatch.setitem(SOUNDS, "long", Tones((Note("C5", 1.7),)))
    monkeypatch.setitem(SOUNDS, "short", Tones((Note("C5", 0.1),)))
    pcm = np.concatenate([say("cancel", pause=1.0), np.zeros(RATE, np.int16)])
    (plain,) = listen(CommandListener(recognizer), pcm)
    assert plain.result.command == "cancel"
    start, end = plain.start - BEGAN, plain.end - BEGAN
    for sound, when, muted in (
        ("long", start - 0.2, True),
        ("long", start + 0.1, False),  # it began before
        ("long", end + 0.1, False),  # the sound came after the word, before the word was processed
        ("long", end - 2.05, False),  # it goes on
        ("short", start - 0.3, False),
        ("unknown", start - 0.2, False),
    ):
        (heard,) = listen(CommandListener(recognizer), pcm, [(sound, when)])
        assert (heard.result.reason, heard.result.command) == (("muted", None) if muted else ("ok", "cancel")), when
        assert heard.result.best == "cancel"


@pytest.mark.parametrize("certain, age, doubtful", [(True, 0.0, False), (False, 0.0, True), (True, 1000.0, True)])
def test_what_is_understood_late_is_doubtful(certain, age, doubtful):
    """No load makes what was said expire: it is asked about if it matters."""
    given, now = [], time.monotonic()
    orders = SimpleNamespace(
        stop_number=lambda when: f"known at {when}",
        put=lambda *command, **more: given.append((command[0], more)) or True,
    )
    node = SimpleNamespace(_orders=orders, _beep=lambda name: None)
    heard = Heard(RecognitionResult("save", "save", 0.99, certain), now - age - 1.0, now - age + 1000.0 * (not age))
    VoiceCommandsNode._handle(node, heard)
    assert given == [("save", {"uncertain": doubtful, "seen_stop": f"known at {now - age - 1.0}"})]
