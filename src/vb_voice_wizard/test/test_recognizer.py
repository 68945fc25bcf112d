"""The voice recogniser: the library as an oracle for its parts, spoken words for the whole."""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from pocketsphinx import Decoder
from scipy.signal import resample_poly

from vb_core.errors import CodedError, ParameterError
from vb_voice_wizard import acoustic_model, phone_scoring, speech_features
from vb_voice_wizard.recognizer import MEASURES, CommandRecognizer, RecognizerParams

sys.path.insert(0, str(Path(__file__).parent))
from speech import RATE, room_noise, say, tone  # noqa: E402


@pytest.fixture(scope="module")
def recognizer():
    return CommandRecognizer()


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """One utterance, and the cepstra and senone scores that the library made of it."""
    folder = tmp_path_factory.mktemp("logs")
    pcm = say("guide robot")
    decoder = Decoder(
        samprate=RATE, lm=None, loglevel="FATAL", compallsen=True, mfclogdir=str(folder), senlogdir=str(folder)
    )
    decoder.add_jsgf_string("commands", "#JSGF V1.0; grammar g; public <c> = guide robot;")
    decoder.activate_search("commands")
    decoder.start_utt()
    decoder.process_raw(pcm.tobytes(), full_utt=True)
    decoder.end_utt()
    cepstra = np.frombuffer(next(folder.glob("*.mfc")).read_bytes(), ">f4", offset=4).reshape(-1, 13)
    data = next(folder.glob("*.sen")).read_bytes()
    data = data[data.index(b"endhdr\n") + 11 :]
    senones = int(np.frombuffer(data, "<i2", count=1)[0])
    scores = np.frombuffer(data, "<i2").reshape(-1, senones + 1)[:, 1:]
    return pcm, cepstra, -scores.astype(float) * 1024 * np.log(1.0001)


def test_cepstra_are_those_of_the_library(logged):
    pcm, expected, _ = logged
    ours = speech_features.cepstra(speech_features.remove_noise(speech_features.mel_spectrum(pcm)))
    # the library adds a last frame, padded with nothing
    np.testing.assert_allclose(ours, expected[: len(ours)], atol=1e-3)
    assert len(ours) >= len(expected) - 1


def test_senone_scores_are_those_of_the_library(logged):
    _, cepstra, expected = logged
    model = acoustic_model.AcousticModel(acoustic_model.embedded_model())
    ours = model.score(speech_features.dynamic(cepstra.astype(float)), np.arange(model.senones))
    ours = ours - ours.max(axis=1, keepdims=True)
    # the library counts only the four nearest Gaussians of each mixture, in steps of 0.1; and pads both ends
    middle = slice(10, -10)
    assert np.corrcoef(ours[middle].ravel(), expected[middle].ravel())[0, 1] > 0.93
    best = expected[np.arange(len(ours)), ours.argmax(axis=1)][middle]
    assert np.median(best) > -0.5


def test_a_broken_model_is_one_clear_error(tmp_path):
    (tmp_path / "mdef").write_bytes(b"BMDF nonsense")
    with pytest.raises(CodedError) as caught:
        acoustic_model.AcousticModel(tmp_path)
    assert caught.value.code == "bad_speech_model"


def test_alignment_prefers_what_was_drawn():
    """Likelihoods that favour one phrase's states in turn: its phones come out where they were put."""
    phones = phone_scoring.PhoneSet(acoustic_model.AcousticModel(acoustic_model.embedded_model()))
    scorer = phone_scoring.PhraseScorer(phones, [[["S", "EY", "V"]], [["K", "AE", "T"]]])
    count = 60
    senones = np.full((count, phones.model.senones), -20.0, dtype=np.float32)
    grouped = np.full((count, len(phones.names), 3), -20.0, dtype=np.float32)
    silence = np.full(count, -20.0, dtype=np.float32)
    silence[:10] = silence[50:] = 0.0
    for number, name in enumerate(("S", "EY", "V")):
        for place in range(3):
            frames = slice(10 + 15 * number + 5 * place - 0, 15 + 15 * number + 5 * place)
            frames = slice(min(frames.start, 50), min(frames.stop, 50))
            mine = (phones.model.codebook == phones.model.number[name]) & (phones.model.place == place)
            senones[frames, mine] = 0.0
            grouped[frames, phones.index[name], place] = 0.0
    likelihoods = phone_scoring.Likelihoods(senones, senones.max(axis=1), silence, grouped)
    alignments = scorer.align(likelihoods)
    first, second = alignments.trace(0), alignments.trace(1)
    assert alignments.scores.tolist() == [first.score, second.score]
    assert [phone for phone, _, _ in first.phones] == ["S", "EY", "V"]
    assert [start for _, start, _ in first.phones] == [10, 25, 40]
    assert first.score > second.score
    scores, heard = phone_scoring.phone_loop(phones, likelihoods, -5.0)
    assert [phone for phone, _, _ in heard] == ["SIL", "S", "EY", "V", "SIL"]
    assert scores.shape == (count,)


@pytest.mark.parametrize("text", ["council", "castle", "say", "shave", "saves", "five", "we do", "resumed", "and you"])
def test_near_misses_are_never_acted_on_unasked(recognizer, text):
    for issue in recognizer.examine(say(text)):
        assert issue.command is None or issue.unclear, f"{text} is surely {issue.command}"


COMMANDS = {
    "define_border": ("define border", "en-us"),
    "define_seed": ("define seed", "en-gb"),
    "guide_robot": ("guide robot", "en-us+f2"),
    "save": ("save", "en-gb+m3"),
    "cancel": ("cancel", "en-us+f4"),
}


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_commands_are_recognised(recognizer, command):
    assert recognizer.recognize(say(*COMMANDS[command])) == command


def test_a_recording_without_any_noise(recognizer):
    pcm = say("define seed", snr_db=200.0)
    assert recognizer.recognize(pcm) == "define_seed"
    assert recognizer.recognize(pcm[int(0.5 * RATE) : -int(0.5 * RATE)]) == "define_seed"


@pytest.mark.parametrize(
    "text", ["what is for dinner tonight", "good afternoon", "the robot got stuck under the sofa", "has anyone seen my glasses"]
)
def test_other_sentences_are_not(recognizer, text):
    assert recognizer.recognize(say(text, "en-gb+f2")) is None


def test_noise_beeps_and_nothing_are_no_commands(recognizer):
    quiet = np.zeros(RATE, dtype=np.int16)
    assert recognizer.examine(quiet) == []
    assert recognizer.recognize(np.zeros(0, dtype=np.int16)) is None
    assert recognizer.recognize(room_noise(3 * RATE, 1000).astype(np.int16)) is None
    for hertz in (440, 880, 1760):
        assert recognizer.recognize(np.concatenate([quiet, tone(hertz, 0.3), quiet])) is None


def test_a_short_vocal_tract_gets_a_second_look(recognizer):
    """Played faster, pitch and formants rise alike: what was understood stays understood, and more is."""
    texts = [text for text, _ in COMMANDS.values()]
    short = [np.rint(resample_poly(say(text).astype(float), 66, 100)).astype(np.int16) for text in texts]
    once = CommandRecognizer(RecognizerParams(rescore_threshold=1.0))
    first, both = ([listener.recognize(pcm) for pcm in short] for listener in (once, recognizer))
    assert all(one in (None, two) for one, two in zip(first, both))
    # what was doubted at first is asked about, however sure the second look is
    looked = [issue for pcm, before in zip(short, first) if before is None for issue in recognizer.examine(pcm)]
    assert all(issue.unclear for issue in looked if issue.command)
    right = [sum(found == command for found, command in zip(each, COMMANDS)) for each in (first, both)]
    assert right[1] >= right[0] and right[1] >= 3


def test_warped_bands_meet_moved_tones():
    for hertz in (300.0, 800.0, 2000.0):
        for warp in (0.85, 1.18):
            plain, warped = (
                speech_features.mel_spectrum(tone(hertz * factor, 0.3), factor)[5:-5].mean(axis=0).argmax()
                for factor in (1.0, warp)
            )
            assert abs(int(plain) - int(warped)) <= 1
    # the highest band stays within the range that the models know
    noise = room_noise(16000, 1000.0)
    assert np.isfinite(speech_features.mel_spectrum(noise, 1.4)).all()


def test_what_was_made_of_it_can_be_seen(recognizer):
    (issue,) = recognizer.examine(say("define border"))
    assert issue.command == issue.best == "define_border" and issue.reason == "ok"
    assert 0.5 <= issue.confidence <= 1.0 and len(issue.measures) == len(MEASURES) and issue.heard
    (issue,) = recognizer.examine(say("has anyone seen my glasses"))
    assert issue.command is None and issue.best and issue.confidence < 0.5
    long = say("this sentence goes on and on and on for much longer than any command could ever take")
    assert [issue.reason for issue in recognizer.examine(long)] == ["too_long"]


def test_only_sound_of_the_expected_kind(recognizer):
    for wrong in (np.zeros(RATE), np.zeros((RATE, 2), dtype=np.int16)):
        with pytest.raises(ValueError, match="int16"):
            recognizer.recognize(wrong)


def test_other_words_by_configuration(tmp_path):
    (tmp_path / "grammar.yaml").write_text("save: [remember this]\ncancel: [stop it]\n")
    (tmp_path / "words.dict").write_text("this DH IH S\n")
    params = RecognizerParams(
        grammar=str(tmp_path / "grammar.yaml"), dictionary=str(tmp_path / "words.dict"), wake_word="computer"
    )
    recognizer = CommandRecognizer(params)
    assert recognizer.recognize(say("computer remember this")) == "save"
    assert recognizer.recognize(say("define border")) is None


def test_bad_files_are_named(tmp_path):
    with pytest.raises(ParameterError) as caught:
        CommandRecognizer(RecognizerParams(wake_word="xyzzyx"))
    assert caught.value.key == "dictionary" and "xyzzyx" in caught.value.message
    with pytest.raises(ParameterError) as caught:
        CommandRecognizer(RecognizerParams(network=str(tmp_path / "none.npz")))
    assert caught.value.key == "network"
    (tmp_path / "decision.yaml").write_text("offset: 0\nweights: {loop: 1}\n")
    with pytest.raises(ParameterError) as caught:
        CommandRecognizer(RecognizerParams(decision=str(tmp_path / "decision.yaml")))
    assert caught.value.key == "decision"
    (tmp_path / "phones.npz").write_bytes(b"nothing")
    with pytest.raises(CodedError) as caught:
        CommandRecognizer(RecognizerParams(network=str(tmp_path / "phones.npz")))
    assert caught.value.code == "bad_phone_network"
