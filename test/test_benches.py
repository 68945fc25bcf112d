"""Runs each bench on a sample of a few seconds, to check that it succeeds; its figures are not checked."""

import shlex
import sys

import cv2
import numpy as np
import pytest
from scipy.io import wavfile

from speech import RATE, room_noise, say
from integrators import flat
from vb_core.grid_map import Transform
from vb_core.map_files import write_map
from vb_testing import TOP, run_command

HANG_S = 1800  # only a bench that hangs takes this long, even on a busy computer

SAMPLES = {
    "detection/clip_accuracy.py": "{recorded} --roles window",
    "detection/scene_accuracy.py": "'robot turns' --share 0.02 --other {top}/src",
    "extraction/accuracy.py": "--only usual --draws 1 --strokes 1 --methods robust",
    "extraction/model_hand.py": "--times 0.01",
    "lab/camera_load.py": "--cameras 1 --seconds 1",
    "lab/stop_under_attack.py": "--seconds 1 --only nothing slow_headers",
    "maps/crashes.py": "--crashes 3",
    "maps/integration_time.py": "--sizes 320x200 --borders 2 --rounds 1",
    "maps/recorded_maps.py": "{recorded}",
    "mutation_testing.py": "--modules vb_evaluation.user_study.recording_measures --each 1",
    "voice/command_recognition.py": "{recorded}",
    "detection/training.py": "--clips {recorded} --scenes grey --examples {folder}/examples --out {folder}/made.json",
}


def test_every_bench_has_a_sample():
    programs = [path for path in TOP.glob("bench/**/*.py") if "def main(" in path.read_text(encoding="utf-8")]
    benches = {str(path.relative_to(TOP / "bench")) for path in programs}
    # drives need the navigation stack, which `make navigation` builds and `make test` does not
    assert benches == set(SAMPLES) | {"robots/drives.py"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Returns a folder with a labelled clip, a spot on a grey floor, what the bench of voice listens to, and two maps."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "clips").mkdir()
    writer = cv2.VideoWriter(str(folder / "clips" / "one.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (320, 240))
    for number in range(40):
        image = np.full((240, 320, 3), 90, np.uint8)
        if number >= 35:
            cv2.circle(image, (160, 120), 3, (120, 120, 255), -1)
        writer.write(image)
    writer.release()
    labels = ",".join(f'{{"frame": {number}, "x": 160, "y": 120, "event": 1}}' for number in range(35, 40))
    (folder / "labels.json").write_text(f'{{"videos": {{"one.avi": {{"width": 320, "labels": [{labels}]}}}}}}')
    spoken = {"stop/one.wav": say("stop"), "sentences/one.wav": say("fine", pause=0.1)}
    for name, pcm in {**spoken, "kitchen.flac": room_noise(5 * RATE, 1000.0).astype(np.int16)}.items():
        (folder / name).parent.mkdir(exist_ok=True)
        wavfile.write(str(folder / name), RATE, pcm)
    write_map(folder / "old", flat())
    write_map(folder / "new", flat(Transform(0.25), seed=1))
    (folder / "pairs.json").write_text('[{"old": "old", "new": "new", "transform": [0.25, 0, 0]}]')
    return folder


@pytest.mark.parametrize("name", SAMPLES)
def test_a_bench_runs(name, tmp_path, recorded):
    words = [word.format(top=TOP, folder=tmp_path, recorded=recorded) for word in shlex.split(SAMPLES[name])]
    done = run_command(sys.executable, TOP / "bench" / name, *words, timeout=HANG_S, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert done.stdout.strip()
