"""Endpointing, wording and reading of sound."""
from __future__ import annotations

import sys
import threading
import wave
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core.errors import CodedError, ParameterError
from vb_voice_wizard import wording
from vb_voice_wizard.audio_sources import Microphone, read_wav, to_model_rate
from vb_voice_wizard.endpointing import Endpointer, EndpointParams, utterances

sys.path.insert(0, str(Path(__file__).parent))
from speech import RATE, room_noise, tone  # noqa: E402

PHONES = ["S", "EY", "V", "B", "AO", "R", "D", "ER"]


# ------------------------------------------------------------------ endpointing
def bursts(spans, total, level=300.0, seed=0):
    """Noise with louder noise of another colour in it: [(start, end) s] in `total` s."""
    pcm = room_noise(int(total * RATE), level, seed)
    rng = np.random.default_rng(seed + 1)
    for start, end in spans:
        pcm[int(start * RATE) : int(end * RATE)] += rng.normal(0, 6 * level, int(end * RATE) - int(start * RATE))
    return pcm.astype(np.int16)


def test_bursts_are_found_where_they_are():
    spans = [(1.0, 1.6), (2.5, 3.5)]
    found = utterances(bursts(spans, 5.0), EndpointParams())
    assert [(pytest.approx(one.start, abs=0.06), pytest.approx(one.end, abs=0.06)) for one in found] == spans
    for one in found:
        assert len(one.pcm) / RATE == pytest.approx(one.end - one.start + 0.4, abs=0.05)


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(1, 4000), min_size=1, max_size=20))
def test_the_size_of_the_pieces_does_not_matter(sizes):
    pcm = bursts([(0.8, 1.3)], 2.5)
    whole = Endpointer(EndpointParams()).push(pcm)
    endpointer, found, at, number = Endpointer(EndpointParams()), [], 0, 0
    while at < len(pcm):
        size = sizes[number % len(sizes)] + 100
        found += endpointer.push(pcm[at : at + size])
        at, number = at + size, number + 1
    assert [(one.start, one.end) for one in found] == [(one.start, one.end) for one in whole]
    assert all(np.array_equal(one.pcm, other.pcm) for one, other in zip(found, whole)) and len(found) == 1


def test_level_does_not_matter():
    for level in (20.0, 2000.0):
        assert len(utterances(bursts([(1.0, 1.5)], 3.0, level), EndpointParams())) == 1


def test_long_speech_is_told_once_and_a_pause_ends_it():
    params = EndpointParams(longest=1.0)
    found = utterances(bursts([(1.0, 3.0), (4.0, 4.5)], 5.5), params)
    assert [one.too_long for one in found] == [True, False]
    # 1 s of speech, its padding, and no more is kept
    assert len(found[0].pcm) <= 1.5 * RATE


def test_a_click_is_no_utterance_and_reset_drops_one():
    assert utterances(bursts([(1.0, 1.04)], 2.5), EndpointParams()) == []
    endpointer, pcm = Endpointer(EndpointParams()), bursts([(1.0, 1.5)], 3.0)
    assert endpointer.push(pcm[: int(1.3 * RATE)]) == [] and endpointer.speaking
    endpointer.reset()
    assert not endpointer.speaking
    assert endpointer.push(pcm[int(1.5 * RATE) :]) == []


def test_the_end_of_a_recording_ends_speech():
    pcm = bursts([(1.0, 2.0)], 2.0)
    assert len(utterances(pcm, EndpointParams())) == 1


def test_a_long_stream_needs_no_memory():
    endpointer = Endpointer(EndpointParams())
    for second in range(60):
        endpointer.push(room_noise(RATE, 300.0, second).astype(np.int16))
    assert len(endpointer._samples) < 3 * RATE


# ------------------------------------------------------------------ wording
def grammar(tmp_path, text):
    path = tmp_path / "grammar.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text, word",
    [
        ("", "expected commands"),
        ("save: [a", "cannot read"),
        ("dance: [dance]", "dance"),
        ("save: save", "list of phrases"),
        ("save: ['']", "list of phrases"),
        ("save: [go]\ncancel: [Go]", "both"),
    ],
)
def test_bad_grammars(tmp_path, text, word):
    with pytest.raises(ParameterError, match=word):
        wording.read_grammar(grammar(tmp_path, text))


def test_phrases_in_every_pronunciation(tmp_path):
    words = tmp_path / "a.dict"
    words.write_text("# comment\nsave S EY V\nsave(2) S EY\nborder B AO R D ER # why\n")
    found = wording.phrases({"save": ["save border"]}, "", [words], PHONES)
    assert [phrase.words for phrase in found] == [
        (("S", "EY", "V"), ("B", "AO", "R", "D", "ER")),
        (("S", "EY"), ("B", "AO", "R", "D", "ER")),
    ]
    other = tmp_path / "b.dict"
    other.write_text("save S\nrobot R\n")
    found = wording.phrases({"save": ["save"]}, "robot", [words, other], PHONES)
    assert [phrase.words for phrase in found] == [(("R",), ("S", "EY", "V")), (("R",), ("S", "EY"))]


def test_unknown_words_and_phones_are_named(tmp_path):
    words = tmp_path / "a.dict"
    words.write_text("save S EY V\nseed S IY D\n")
    with pytest.raises(ParameterError, match="'frobnicate'"):
        wording.phrases({"save": ["frobnicate"]}, "", [words], PHONES)
    with pytest.raises(ParameterError, match="'seed'.*IY"):
        wording.phrases({"save": ["seed"]}, "", [words], PHONES)
    with pytest.raises(ParameterError, match="no file"):
        wording.find("grammar", str(tmp_path / "none"), "commands.yaml")


# ------------------------------------------------------------------ sound
def write_wav(path, samples, rate=RATE, channels=1, width=2):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(width)
        file.setframerate(rate)
        file.writeframes(samples.tobytes())


def test_wav_files_of_all_rates(tmp_path):
    beep = tone(500, 0.5)
    write_wav(tmp_path / "a.wav", beep)
    assert np.array_equal(read_wav(tmp_path / "a.wav"), beep)
    write_wav(tmp_path / "b.wav", np.repeat(beep, 2), channels=2)
    assert np.array_equal(read_wav(tmp_path / "b.wav"), beep)
    time = np.arange(22050) / 44100
    write_wav(tmp_path / "c.wav", (6000 * np.sin(2 * np.pi * 500 * time)).astype(np.int16), rate=44100)
    converted = read_wav(tmp_path / "c.wav")
    assert len(converted) == len(beep)
    assert np.abs(converted[800:-800].astype(int) - beep[800:-800]).max() < 60
    assert np.array_equal(to_model_rate(beep, RATE), beep)


def test_bad_wav_files(tmp_path):
    with pytest.raises(CodedError, match="cannot read"):
        read_wav(tmp_path / "none.wav")
    (tmp_path / "text.wav").write_text("no sound at all")
    with pytest.raises(CodedError, match="cannot read"):
        read_wav(tmp_path / "text.wav")
    write_wav(tmp_path / "bytes.wav", np.zeros(100, dtype=np.uint8), width=1)
    with pytest.raises(CodedError, match="16 bits"):
        read_wav(tmp_path / "bytes.wav")


def test_a_recording_program_is_read_and_started_again():
    chunks, troubles, enough = [], [], threading.Event()

    def take(samples):
        chunks.append(samples)
        if len(chunks) == 4:
            enough.set()

    program = [sys.executable, "-c", "import sys; sys.stdout.buffer.write(bytes(range(200)) * 2)"]
    microphone = Microphone(program, take, troubles.append, chunk=100, retry=0.0)
    assert enough.wait(20)
    microphone.close()
    assert all(len(samples) == 100 for samples in chunks)
    assert np.array_equal(chunks[0], np.frombuffer(bytes(range(200)), "<i2"))
    assert "ended with status 0" in troubles[0]


def test_a_missing_recording_program_is_told():
    told = threading.Event()
    sentences = []
    microphone = Microphone(["no_such_program"], lambda _: None, lambda text: (sentences.append(text), told.set()))
    assert told.wait(20)
    microphone.close()
    assert "cannot start no_such_program" in sentences[0]
