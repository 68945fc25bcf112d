"""The voice recogniser and its parts, with espeak-ng's voices: utterances, streams with our sounds, microphones."""

import itertools
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from refusals import refused
from vb_testing import assert_fields
from speech import RATE, command_in, examine, room_noise, say, tone, utterances
from vb_core.sentences import words_of_name
from vb_core.sounds import SOUNDS, Note, Melody
from vb_voice_wizard.voice.microphone import CHUNK_SAMPLES, Microphone, has_sound
from vb_voice_wizard.voice.endpointing import CHUNK, MAX_UTTERANCE, Endpointer, SpeechDetector
from vb_voice_wizard.voice.recognizer import THRESHOLD, CommandListener, CommandRecognizer, RecognitionResult
from vb_voice_wizard.voice.speech_model import MODEL_FOLDER, SpeechModel
from vb_voice_wizard.voice_commands_node import VoiceCommandsNode

VOICES = "en-us en-gb en-us+f2 en-gb+m3 en-us+f4 en-us en-gb en-us+m3 en-gb+f2".split()
SPOKEN = dict(zip("define_border define_seed guide_robot save cancel stop resume undo redo".split(), VOICES))


@pytest.fixture(scope="module")
def recognizer():
    return CommandRecognizer()


def test_commands_are_recognised_most_of_the_time(recognizer):
    """One voice in one noise each: bench/voice/command_recognition.py measures how often they are."""
    results = {command: examine(recognizer, say(words_of_name(command), voice))[0] for command, voice in SPOKEN.items()}
    assert all(result.command in (None, command) for command, result in results.items()), results
    recognised = [result for result in results.values() if result.command]
    assert len(recognised) >= 6, results
    assert all(result.best == result.command and result.reason == "ok" for result in recognised)
    assert all(result.confidence >= THRESHOLD for result in recognised)


def test_a_result_contains_the_best_guess_and_why_it_is_no_command(recognizer):
    (result,) = examine(recognizer, say("has anyone seen my glasses"))
    assert_fields(result, command=None, reason="unlike_a_command")
    assert result.best
    assert result.confidence < THRESHOLD
    long = say("this sentence goes on and on and on for much longer than any command could ever take")
    assert [result.reason for result in examine(recognizer, long)] == ["too_long"]


@pytest.mark.parametrize("text", ["what is for dinner tonight", "good afternoon", "the robot got stuck under the sofa"])
def test_other_sentences_are_not_commands(recognizer, text):
    assert command_in(recognizer, say(text, "en-gb+f2")) is None


def test_noise_beeps_and_nothing_are_no_commands(recognizer):
    quiet = np.zeros(RATE, dtype=np.int16)
    assert examine(recognizer, quiet) == []
    assert command_in(recognizer, np.zeros(0, dtype=np.int16)) is None
    assert utterances(room_noise(4 * RATE, 2000.0).astype(np.int16)) == []
    for hertz in (440, 880, 1760):
        assert command_in(recognizer, np.concatenate([quiet, tone(hertz, 0.3), quiet])) is None


def test_the_speech_model_gives_what_was_said_not_how_loud():
    texts = ["define seed", "define seeds", "save", "undo", "and do"]
    model = SpeechModel(texts)
    pcm = say("define seed", snr_db=25.0)
    every = np.arange(len(texts))
    ratios = model.log_likelihood_ratios(pcm, every)
    assert ratios.shape == (5,)
    assert texts[int(ratios.argmax())] == "define seed"
    np.testing.assert_allclose(model.log_likelihood_ratios((pcm // 4).astype(np.int16), every), ratios, atol=1.5)
    # the other texts do not matter
    assert SpeechModel(["save"]).log_likelihood_ratios(pcm, every[:1])[0] == pytest.approx(ratios[2], abs=1.0)
    assert np.isfinite(model.log_likelihood_ratios(np.zeros(RATE // 5, np.int16), every)).all()


def test_a_missing_or_damaged_file_of_the_model_is_named(tmp_path):
    empty, damaged, incomplete = (tmp_path / name for name in ("empty", "damaged", "incomplete"))
    damaged.mkdir()
    (damaged / "encoder_model.ort").write_bytes(b"nothing")
    incomplete.mkdir()
    for name in ("encoder_model.ort", "decoder_model_merged.ort"):
        (incomplete / name).symlink_to(MODEL_FOLDER / name)
    for folder, name in ((empty, "encoder_model"), (damaged, "encoder_model"), (incomplete, "tokenizer")):
        with refused("no_speech_model") as caught:
            SpeechModel(["save"], folder)
        assert name in str(caught.value.values["file"])


@pytest.mark.parametrize(
    "before", ["no", "what are you doing", "this sentence goes on and on and on for much longer than any command"]
)
def test_a_stop_at_the_end_of_talk_counts(recognizer, before):
    """One voice in one noise each: bench/voice/command_recognition.py measures how often it does."""
    voices = ("en-us", "en-gb", "en-us+f2")
    commands = [command_in(recognizer, say(f"{before} stop", voice, snr_db=25.0)) for voice in voices]
    assert {"stop"} <= set(commands) <= {"stop", None}


# ------------------------------------------------------------------ a stream
PART = RATE // 20
STREAM_START = 1000.0  # [s] of the clock


def listen(listener, pcm, sounds=()):
    """Streams speech and our own sounds, (name, start [s] in the stream); returns the recognised utterances."""
    utterances = []
    waiting = sorted(sounds, key=lambda sound: sound[1])
    for begin in range(0, len(pcm), PART):
        while waiting and waiting[0][1] * RATE < begin + PART:
            name, start = waiting.pop(0)
            listener.play(name, STREAM_START + start)
        utterances += listener.push(pcm[begin : begin + PART], STREAM_START + (begin + PART) / RATE)
    return utterances


def test_times_are_when_it_was_said(recognizer):
    pcm = np.concatenate([np.zeros(2 * RATE, np.int16), say("stop", pause=0.6), np.zeros(RATE, np.int16)])
    (utterance,) = listen(CommandListener(recognizer), pcm)
    assert utterance.command == "stop"
    assert utterance.start == pytest.approx(STREAM_START + 2.6, abs=0.15)
    assert 0.2 < utterance.end - utterance.start < 0.8


@pytest.mark.parametrize("sound", ["error", "success", "stopped", "recognized"])
def test_stop_counts_whenever_a_sound_of_ours_plays(recognizer, sound):
    pcm = np.concatenate([say("stop", pause=1.0), np.zeros(RATE, np.int16)])
    for start in np.arange(0.0, 2.6, 0.2):
        (utterance,) = listen(CommandListener(recognizer), pcm, [(sound, start)])
        assert utterance.command == "stop"


def test_another_command_counts_unless_it_lies_within_a_sound_of_ours(recognizer, monkeypatch):
    monkeypatch.setitem(SOUNDS, "long", Melody((Note("C5", 1.7),)))
    monkeypatch.setitem(SOUNDS, "short", Melody((Note("C5", 0.1),)))
    pcm = np.concatenate([say("cancel", pause=1.0), np.zeros(RATE, np.int16)])
    (plain,) = listen(CommandListener(recognizer), pcm)
    assert plain.command == "cancel"
    start, end = plain.start - STREAM_START, plain.end - STREAM_START
    for sound, sound_start, reason in (
        ("long", start - 0.2, "muted"),
        ("long", start + 0.1, "ok"),  # speech began before the sound
        ("long", end + 0.1, "ok"),  # the sound began after the word, but before it was processed
        ("long", end - 2.05, "ok"),  # speech goes on after the sound
        ("short", start - 0.3, "ok"),
        ("unknown", start - 0.2, "ok"),
    ):
        (utterance,) = listen(CommandListener(recognizer), pcm, [(sound, sound_start)])
        assert utterance.reason == reason, sound_start
        assert_fields(utterance, command=None if reason == "muted" else "cancel", best="cancel")


@pytest.mark.parametrize("certain, end, uncertain", [(True, 1e3, False), (False, 1e3, True), (True, -1e3, True)])
def test_a_command_understood_late_is_uncertain(certain, end, uncertain):
    """Speech does not expire under load: a late command with consequences is asked about. `end`: [s] from now."""
    given = []
    now = time.monotonic()
    sender = SimpleNamespace(
        stop_number=lambda time: f"known at {time}",
        submit=lambda command, _context, **fields: given.append((command, fields)) or True,
    )
    node = SimpleNamespace(_command_sender=sender, _beep=lambda name: None)
    heard = RecognitionResult("save", "save", 0.99, certain, start=now - 1001.0, end=now + end)
    VoiceCommandsNode._handle(node, heard)
    assert given == [("save", {"uncertain": uncertain, "seen_stop": f"known at {now - 1001.0}"})]


# ------------------------------------------------------------------ endpointing
STEP = CHUNK / RATE


def detector_of(spans, faint=()):
    """Returns a speech detector that is sure of speech in `spans`, [(start, end) s], and doubts that in `faint`."""
    count = itertools.count()

    def probability(data):
        assert len(data) == 2 * CHUNK
        middle = (next(count) + 0.5) * STEP
        if any(start <= middle < end for start, end in spans):
            return 0.9
        return 0.4 if any(start <= middle < end for start, end in faint) else 0.1

    return probability


def cut_utterances(spans, total, size=RATE // 20, faint=()):
    """Returns the utterances of a stream of `total` seconds, pushed in pieces of `size` samples."""
    endpointer = Endpointer(detector_of(spans, faint))
    pcm = (np.arange(int(total * RATE)) % 30000).astype(np.int16)  # each sample's value is its position
    return [speech for start in range(0, len(pcm), size) for speech in endpointer.push(pcm[start : start + size])]


@pytest.mark.parametrize("size", [37, 511, 512, 513, 4000, 100000])
def test_speech_is_cut_where_it_is_whatever_the_size_of_the_pieces(size):
    spans = [(1.0, 1.6), (2.5, 3.5)]
    utterances = cut_utterances(spans, 5.0, size=size)
    np.testing.assert_allclose([(speech.start, speech.end) for speech in utterances], spans, atol=STEP)
    for speech in utterances:
        padding = len(speech.pcm) / RATE - (speech.end - speech.start)
        assert padding == pytest.approx(0.4, abs=2 * STEP)
        first_sample = int((speech.start - padding / 2.0) * RATE)
        assert abs(int(speech.pcm[0]) - first_sample % 30000) <= 2 * CHUNK


def test_long_speech_is_reported_once_and_a_pause_ends_it():
    utterances = cut_utterances([(1.0, 5.0), (6.0, 6.5)], 7.5)
    assert [speech.too_long for speech in utterances] == [True, False]
    # no more than this much speech and its padding is kept
    assert len(utterances[0].pcm) <= (MAX_UTTERANCE + 0.5) * RATE


@pytest.mark.parametrize(
    "spans, faint, total, expected",
    [
        ([(1.0, 1.03)], [], 2.5, []),  # a click is not an utterance
        ([(1.0, 1.4), (1.55, 2.0)], [], 2.5, [(1.0, 2.0)]),  # a pause within a phrase does not end it
        ([(1.0, 1.5)], [(1.5, 2.5), (3.5, 4.5)], 5.0, [(1.0, 2.5)]),  # faint speech only continues it
    ],
)
def test_a_click_is_no_utterance_and_a_short_pause_ends_none(spans, faint, total, expected):
    utterances = [(speech.start, speech.end) for speech in cut_utterances(spans, total, faint=faint)]
    np.testing.assert_allclose(np.reshape(utterances, (-1, 2)), np.reshape(expected, (-1, 2)), atol=STEP)


def test_what_was_heard_long_ago_does_not_decide_what_is_speech():
    """The network's own memory makes it deaf after a minute of talk; the detector's memory is two seconds."""
    talk = say("this sentence goes on and on and on for much longer than any command could ever take", pause=0.1)
    same = say("and now the same for both of them", pause=1.0)[: int(4.0 * RATE)]
    count = int(30 * RATE) // CHUNK * CHUNK
    probabilities = []
    for before in (np.zeros(count, np.int16), np.resize(talk, count)):
        detect = SpeechDetector()
        pcm = np.concatenate([before, same])
        chunks = pcm[: len(pcm) // CHUNK * CHUNK].reshape(-1, CHUNK)
        probabilities.append([detect(chunk.tobytes()) for chunk in chunks])
    after_silence, after_talk = probabilities
    forgotten = count // CHUNK + int(2.1 / STEP)
    assert max(after_silence[forgotten:]) > 0.8
    assert after_silence[forgotten:] == after_talk[forgotten:]
    assert after_silence[: count // CHUNK] != after_talk[: count // CHUNK]


# ------------------------------------------------------------------ sound
def test_a_microphone_that_is_on_is_known_by_its_noise_however_loud():
    loudest = np.array([-32768, 32767] * 400, np.int16)  # their difference overflows int16
    assert [has_sound(pcm) for pcm in (loudest, np.array([5, 8, 6], np.int16))] == [True, True]
    assert [has_sound(pcm) for pcm in (np.full(800, 300, np.int16), np.zeros(0, np.int16))] == [False, False]


def test_a_recording_program_is_read_and_started_again():
    troubles = []
    # the program writes more to its standard error than a pipe holds
    script = f"import sys; sys.stderr.write('overrun!\\n' * 20000); sys.stdout.buffer.write(bytes(range(200)) * {CHUNK_SAMPLES // 50})"
    microphone = Microphone([sys.executable, "-c", script], troubles.append, retry=0.0)
    pieces = [microphone.get() for _ in range(4)]
    microphone.close()
    assert np.array_equal(np.concatenate(pieces[2:]), np.frombuffer(bytes(range(200)) * (CHUNK_SAMPLES // 50), "<i2"))
    assert troubles == [f"{sys.executable} ended with status 0: overrun!"]
    while microphone.get() is not None:
        pass
    assert len(troubles) == 1  # closing it is not reported as trouble


def test_a_missing_recording_program_is_reported():
    troubles = []
    microphone = Microphone(["no_such_program"], lambda text: (troubles.append(text), microphone.close()))
    assert microphone.get() is None
    (trouble,) = troubles
    assert "cannot start no_such_program" in trouble
