"""The synthesis of sounds, and their way to the device."""

import itertools

import numpy as np
import pytest

from refusals import refused
from vb_testing import write_program
from vb_core.errors import CodedError
from vb_core.interaction_tables import STATES
from vb_core.sounds import PITCHES, SOUNDS
from vb_feedback.sound.sound_output import SAMPLE_RATE, play, synthesize


def pitch(pcm):
    """Returns the frequency [Hz] of the strongest spectral line."""
    spectrum = np.abs(np.fft.rfft(pcm * np.hanning(len(pcm)), 1 << 17))
    return np.argmax(spectrum) * SAMPLE_RATE / (1 << 17)


@pytest.mark.parametrize("name", SOUNDS)
def test_each_note_has_the_pitch_that_it_says(name):
    pcm = synthesize(name).astype(float)
    start = 0
    for note in SOUNDS[name].notes:
        part = pcm[start : start + int(round(note.seconds * SAMPLE_RATE))]
        start += len(part)
        if note.pitch:
            # a short note has a broad spectral line
            assert abs(pitch(part) - PITCHES[note.pitch]) < 0.25 / note.seconds
        else:
            assert not part.any()
    assert start == len(pcm)


def test_sounds_can_be_distinguished():
    for one, other in itertools.combinations(SOUNDS, 2):
        notes = [[(note.pitch, round(note.seconds, 2)) for note in SOUNDS[name].notes] for name in (one, other)]
        assert notes[0] != notes[1]
    # the states' last notes are at least a minor third apart, which untrained ears hear; a refusal is below them all
    ends = sorted(PITCHES[state.tone[1]] for state in STATES.values())
    assert all(high / low > 1.18 for low, high in zip(ends, ends[1:]))
    assert max(PITCHES.get(note.pitch, 0.0) for note in SOUNDS["error"].notes) * 2 < min(ends)


@pytest.mark.parametrize("name", SOUNDS)
def test_nothing_clicks_or_is_cut_off(name):
    pcm = synthesize(name).astype(int)
    assert 0 < len(pcm) < SAMPLE_RATE
    assert np.abs(pcm).max() < 32767 * 0.7
    assert np.abs(pcm[[0, -1]]).max() < 300


def test_a_tick_is_soft_and_volume_counts():
    powers = {name: float((synthesize(name).astype(float) ** 2).sum()) for name in SOUNDS}
    tick_power = powers.pop("tick")
    assert tick_power * 100 < min(powers.values())
    assert np.abs(synthesize("border", 0.5)).max() == pytest.approx(np.abs(synthesize("border")).max() / 2, abs=1)
    assert not synthesize("border", 0.0).any()


# ----------------------------------------------------------------- the device
def test_the_player_gets_all_samples(tmp_path):
    pcm = synthesize("success")
    player = write_program(tmp_path / "player", f'echo "$@" > {tmp_path}/arguments; cat > {tmp_path}/pcm')
    play(pcm, "front", player)
    assert np.array_equal(np.fromfile(str(tmp_path / "pcm"), "<i2"), pcm)
    assert (tmp_path / "arguments").read_text().split() == "-q -D front -t raw -f S16_LE -r 48000 -c 1".split()


def test_a_missing_device_is_refused_with_the_reason(tmp_path):
    says = "cat > /dev/null; echo 'audio open error: No such device' >&2; exit 1"
    with pytest.raises(CodedError, match="No such device"):
        play(synthesize("tick"), "front", write_program(tmp_path / "player", says))
    with refused("no_audio"):
        play(synthesize("tick"), "front", str(tmp_path / "none"))
