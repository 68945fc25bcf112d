"""Endpointing, and sound from a microphone."""

from __future__ import annotations

import itertools
import sys

import numpy as np
import pytest

from vb_voice_wizard.voice.audio_sources import PIECE, Microphone, has_sound
from vb_voice_wizard.voice.endpointing import CHUNK, MAX_UTTERANCE, Endpointer, SpeechDetector

from speech import RATE, room_noise, say, utterances

# ------------------------------------------------------------------ endpointing
STEP = CHUNK / RATE


def spoken_at(spans, faint=()):
    """A detector of speech that knows where it is: [(start, end) s], and where it may be; tells its chunks by counting."""
    count = itertools.count()

    def probability(data):
        assert len(data) == 2 * CHUNK
        middle = (next(count) + 0.5) * STEP
        levels = [0.9] * len(spans) + [0.4] * len(faint)
        return max(
            [level for (start, end), level in zip([*spans, *faint], levels) if start <= middle < end], default=0.1
        )

    return probability


def cut(spans, total, size=RATE // 20, faint=()):
    endpointer, pcm = Endpointer(spoken_at(spans, faint)), (np.arange(int(total * RATE)) % 30000).astype(np.int16)
    # each sample says where it is
    return [one for at in range(0, len(pcm), size) for one in endpointer.push(pcm[at : at + size])]


@pytest.mark.parametrize("size", [37, 511, 512, 513, 4000, 100000])
def test_speech_is_cut_where_it_is_whatever_the_size_of_the_pieces(size):
    spans = [(1.0, 1.6), (2.5, 3.5)]
    found = cut(spans, 5.0, size=size)
    assert [(pytest.approx(one.start, abs=STEP), pytest.approx(one.end, abs=STEP)) for one in found] == spans
    for one in found:
        assert len(one.pcm) / RATE == pytest.approx(one.end - one.start + 0.4, abs=2 * STEP)
        begin = int(round(one.start * RATE)) - int(one.pcm.size - (one.end - one.start) * RATE) // 2
        assert abs(int(one.pcm[0]) - begin % 30000) <= 2 * CHUNK


def test_long_speech_is_told_once_and_a_pause_ends_it():
    found = cut([(1.0, 5.0), (6.0, 6.5)], 7.5)
    assert [one.too_long for one in found] == [True, False]
    # so much speech, its padding, and no more is kept
    assert len(found[0].pcm) <= (MAX_UTTERANCE + 0.5) * RATE


@pytest.mark.parametrize(
    "spans, faint, total, expected",
    [
        ([(1.0, 1.03)], [], 2.5, []),  # a click is none
        ([(1.0, 1.4), (1.55, 2.0)], [], 2.5, [(1.0, 2.0)]),  # a pause within a phrase does not end it
        ([(1.0, 1.5)], [(1.5, 2.5), (3.5, 4.5)], 5.0, [(1.0, 2.5)]),  # it goes on where it is too faint to begin
    ],
)
def test_what_is_one_utterance(spans, faint, total, expected):
    found = [(one.start, one.end) for one in cut(spans, total, faint=faint)]
    np.testing.assert_allclose(np.reshape(found, (-1, 2)), np.reshape(expected, (-1, 2)), atol=STEP)


def test_a_voice_is_found_and_noise_is_not():
    voice = np.concatenate([np.zeros(RATE), say("define border"), np.zeros(RATE)]).astype(np.int16)
    found = utterances(voice)
    assert len(found) == 1 and 1.4 < found[0].start < 1.8
    assert utterances(room_noise(4 * RATE, 2000.0).astype(np.int16)) == []


def test_what_was_heard_long_ago_does_not_decide_what_is_speech():
    """The network's own memory makes it deaf after a minute of talk; the detector's ends after two seconds."""
    talk = say("this sentence goes on and on and on for much longer than any command could ever take", pause=0.1)
    same = say("and now the same for both of them", pause=1.0)[: int(4.0 * RATE)]
    count = int(30 * RATE) // CHUNK * CHUNK
    told = []
    for before in (np.zeros(count, np.int16), np.resize(talk, count)):
        detect, pcm = SpeechDetector(), np.concatenate([before, same])
        told.append([detect(pcm[at : at + CHUNK].tobytes()) for at in range(0, len(pcm) - CHUNK + 1, CHUNK)])
    known = count // CHUNK + int(2.1 / STEP)
    assert max(told[0][known:]) > 0.8 and told[0][known:] == told[1][known:]
    assert told[0][: count // CHUNK] != told[1][: count // CHUNK]


# ------------------------------------------------------------------ sound
def test_a_microphone_that_is_on_is_known_by_its_noise_however_loud():
    loudest = np.array([-32768, 32767] * 400, np.int16)  # their difference is more than int16 holds
    assert has_sound(loudest) and has_sound(np.array([5, 8, 6], np.int16))
    assert not has_sound(np.full(800, 300, np.int16)) and not has_sound(np.zeros(0, np.int16))


def test_a_recording_program_is_read_and_started_again():
    troubles = []
    # what it writes to its standard error is more than a pipe holds
    script = f"import sys; sys.stderr.write('overrun!\\n' * 20000); sys.stdout.buffer.write(bytes(range(200)) * {PIECE // 50})"
    microphone = Microphone([sys.executable, "-c", script], troubles.append, retry=0.0)
    pieces = [microphone.get() for _ in range(4)]
    microphone.close()
    assert np.array_equal(np.concatenate(pieces[2:]), np.frombuffer(bytes(range(200)) * (PIECE // 50), "<i2"))
    assert troubles == [f"{sys.executable} ended with status 0: overrun!"]
    while microphone.get() is not None:
        pass
    assert len(troubles) == 1  # that it was closed is no trouble


def test_a_missing_recording_program_is_reported():
    told = []
    microphone = Microphone(["no_such_program"], lambda text: (told.append(text), microphone.close()))
    assert microphone.get() is None
    assert len(told) == 1 and "cannot start no_such_program" in told[0]
